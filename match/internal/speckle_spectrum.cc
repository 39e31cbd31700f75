#include "match/internal/speckle_spectrum.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>

namespace plumbline::internal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kLargestTile = 128;
constexpr int kSmallestTile = 16;
constexpr int kMostTiles = 400;
constexpr double kFewestWanted = 0.6;  // of a tile's pixels

std::vector<double> HannWindow(int n) {
  std::vector<double> window(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) {
    window[static_cast<std::size_t>(i)] = 0.5 - 0.5 * std::cos(2 * M_PI * (i + 0.5) / n);
  }
  return window;
}

// |DFT|^2, added to `power`.
void AddPower(const cv::Mat& tile, double factor, std::vector<double>& power) {
  cv::Mat spectrum;
  cv::dft(tile, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int y = 0; y < tile.rows; ++y) {
    for (int x = 0; x < tile.cols; ++x) {
      const cv::Vec2d f = spectrum.at<cv::Vec2d>(y, x);
      power[static_cast<std::size_t>(y * tile.cols + x)] += factor * (f[0] * f[0] + f[1] * f[1]);
    }
  }
}

// The tile less its mean, windowed; false where the mask leaves too little of it. *sum2: of the
// squared window over the pixels that count.
bool CutTile(const GrayImage& image, const Image<std::uint8_t>& mask, int x0, int y0,
             const std::vector<double>& window, cv::Mat& tile, double* sum2) {
  const int n = tile.rows;
  const auto wanted = [&](int y, int x) { return mask.empty() || mask(y0 + y, x0 + x) != 0; };
  double mean = 0;
  int count = 0;
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      if (!wanted(y, x)) continue;
      mean += image.grey(y0 + y, x0 + x);
      ++count;
    }
  }
  if (count < kFewestWanted * n * n) return false;
  mean /= count;
  *sum2 = 0;
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      const double w = window[static_cast<std::size_t>(y)] * window[static_cast<std::size_t>(x)];
      tile.at<double>(y, x) = wanted(y, x) ? w * (image.grey(y0 + y, x0 + x) - mean) : 0;
      *sum2 += wanted(y, x) ? w * w : 0;
    }
  }
  return *sum2 > 0;
}

// The inverse transform of a real, symmetric spectrum, averaged over circles of whole radius.
std::vector<double> RadialInverse(const std::vector<double>& power, int n) {
  cv::Mat spectrum(n, n, CV_64F), out;
  std::copy(power.begin(), power.end(), spectrum.ptr<double>());
  std::vector<double> sum(static_cast<std::size_t>(n / 2), 0), count(sum.size(), 0);
  // Each lag shares itself between the two whole radii about it.
  cv::dft(spectrum, out, cv::DFT_COMPLEX_OUTPUT | cv::DFT_SCALE);
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      const double r = std::hypot(std::min(x, n - x), std::min(y, n - y));
      const auto lower = static_cast<std::size_t>(r);
      const double share = r - static_cast<double>(lower);
      for (const auto& [at, weight] : {std::pair{lower, 1 - share}, {lower + 1, share}}) {
        if (at >= sum.size()) continue;
        sum[at] += weight * out.at<cv::Vec2d>(y, x)[0];
        count[at] += weight;
      }
    }
  }
  for (std::size_t i = 0; i < sum.size(); ++i) sum[i] /= std::max(count[i], 1e-12);
  return sum;
}

}  // namespace

TileSpectrum::TileSpectrum(const GrayImage& image, const Image<std::uint8_t>& mask) {
  for (int n = kLargestTile; n >= kSmallestTile && tile_px_ == 0; n /= 2) {
    if (n > image.width() || n > image.height()) continue;
    const std::vector<double> window = HannWindow(n);
    power_.assign(static_cast<std::size_t>(n) * static_cast<std::size_t>(n), 0);
    window_.assign(power_.size(), 0);
    const int columns = std::max(1, 2 * (image.width() - n) / n + 1);
    const int rows = std::max(1, 2 * (image.height() - n) / n + 1);
    // Spread over the image where it has more tiles than needed.
    const int skip = std::max(1, columns * rows / kMostTiles);
    cv::Mat tile(n, n, CV_64F);
    int tiles = 0;
    for (int i = 0; i < columns * rows; i += skip) {
      const int x0 = columns > 1 ? i % columns * (image.width() - n) / (columns - 1) : 0;
      const int y0 = rows > 1 ? i / columns * (image.height() - n) / (rows - 1) : 0;
      double sum2 = 0;
      if (!CutTile(image, mask, x0, y0, window, tile, &sum2)) continue;
      AddPower(tile, 1 / sum2, power_);
      ++tiles;
    }
    if (tiles == 0) continue;
    tile_px_ = n;
    for (double& p : power_) p /= tiles;
    double sum2 = 0;
    for (int y = 0; y < n; ++y) {
      for (int x = 0; x < n; ++x) {
        const double w = window[static_cast<std::size_t>(y)] * window[static_cast<std::size_t>(x)];
        tile.at<double>(y, x) = w;
        sum2 += w * w;
      }
    }
    AddPower(tile, 1 / sum2, window_);
  }
}

double TileSpectrum::FloorGrey2() const {
  if (empty()) return kNan;
  double sum = 0;
  int count = 0;
  const auto frequency = [&](int i) {
    return static_cast<double>(std::min(i, tile_px_ - i)) / tile_px_;
  };
  for (int y = 0; y < tile_px_; ++y) {
    for (int x = 0; x < tile_px_; ++x) {
      if (frequency(x) < 0.4 || frequency(y) < 0.4) continue;
      sum += power_[static_cast<std::size_t>(y * tile_px_ + x)];
      ++count;
    }
  }
  return count > 0 ? sum / count : kNan;
}

double TileSpectrum::FeatureSizePx(double noise_grey2) const {
  if (empty()) return kNan;
  std::vector<double> signal = power_;
  for (double& p : signal) p -= noise_grey2;
  const std::vector<double> with_window = RadialInverse(signal, tile_px_);
  const std::vector<double> window = RadialInverse(window_, tile_px_);
  const double top = with_window[0] / window[0];
  if (!(top > 0.05 * noise_grey2) || !(top > 0)) return kNan;
  double before = 1;
  for (std::size_t r = 1; r < with_window.size(); ++r) {
    const double now = with_window[r] / window[r] / top;
    if (now < 0.5) {
      return 2 * (static_cast<double>(r) - 1 + (before - 0.5) / (before - now));
    }
    before = now;
  }
  return kNan;
}

std::vector<double> TileSpectrum::Radial() const {
  const auto n = static_cast<std::size_t>(tile_px_ / 2);
  std::vector<double> sum(n, 0), count(n, 0);
  for (int y = 0; y < tile_px_; ++y) {
    for (int x = 0; x < tile_px_; ++x) {
      const double r = std::hypot(std::min(x, tile_px_ - x), std::min(y, tile_px_ - y));
      const auto at = static_cast<std::size_t>(std::lround(r));
      if (at >= n) continue;
      sum[at] += power_[static_cast<std::size_t>(y * tile_px_ + x)];
      ++count[at];
    }
  }
  for (std::size_t i = 0; i < n; ++i) sum[i] /= std::max(count[i], 1.0);
  return sum;
}

double TileSpectrum::BlurPx(double noise_grey2, double feature_px) const {
  if (empty() || !(feature_px > 0)) return kNan;
  const std::vector<double> power = Radial();
  // ln(P f^3) = c - (2 pi sigma f)^2, from beyond the features' own frequency on.
  const double first = 0.6 / feature_px * tile_px_;
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (std::size_t i = 2; i + 1 < power.size(); ++i) {
    const double signal = power[i] - noise_grey2;
    if (signal < noise_grey2) {
      if (static_cast<double>(i) > first) break;
      continue;
    }
    if (static_cast<double>(i) < first) continue;
    const double f = static_cast<double>(i) / tile_px_;
    if (f > 0.4) break;
    const double x = f * f, y = std::log(signal * f * f * f);
    n += 1;
    sx += x;
    sy += y;
    sxx += x * x;
    sxy += x * y;
  }
  if (n < 4) return kNan;
  const double slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
  return std::sqrt(std::max(0.0, -slope)) / (2 * M_PI);
}

}  // namespace plumbline::internal
