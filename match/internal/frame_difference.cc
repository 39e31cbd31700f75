#include "match/internal/frame_difference.h"

#include <oneapi/tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "calib/median.h"
#include "match/noise_model.h"

namespace plumbline::internal {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Of the fit to a tile: 1, x, y, the same times the grey level, gradients in x and y.
constexpr int kParameters = 8;
using Parameters = Eigen::Matrix<double, kParameters, 1>;
constexpr int kFewestPixels = 100;  // of a tile
constexpr int kCoarseLevels = 32;   // that the first variances are told apart by
constexpr double kCut = 5;          // residuals beyond so many sigmas are not noise

struct Tile {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;                    // without the last ones
  int fitted = 0;                                        // pixels; 0: too few
  double cut = std::numeric_limits<double>::infinity();  // of the residuals for certain no noise
  Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();
  double sigma_motion_px = std::numeric_limits<double>::infinity();
  double excess = 1;  // scatter, over what pixels of its grey levels have elsewhere
  bool changed = false;
};

// One pair of frames, on the way to its residuals.
class Differencer {
 public:
  Differencer(const GrayImage& a, const GrayImage& b, const Image<std::uint8_t>& mask, int tile_px)
      : a_(a.grey), b_(b.grey), residual_(a.size(), kNan), mask_(mask) {
    limits_ = FindGreyLimits(a, b);
    for (int y = 1; y < a.height() - 1; y += tile_px) {
      for (int x = 1; x < a.width() - 1; x += tile_px) {
        Tile tile;
        tile.x0 = x;
        tile.y0 = y;
        tile.x1 = std::min(x + tile_px, a.width() - 1);
        tile.y1 = std::min(y + tile_px, a.height() - 1);
        tiles_.push_back(tile);
      }
    }
  }

  FrameDifference Run() {
    ForEachTile([&](Tile& tile) { FitTile(tile); });
    FindVariances();
    ForEachTile([&](Tile& tile) { Judge(tile); });
    RejectChangedTiles();
    return Summary();
  }

 private:
  template <typename Body>
  void ForEachTile(const Body& body) {
    tbb::parallel_for(std::size_t{0}, tiles_.size(), [&](std::size_t i) { body(tiles_[i]); });
  }

  bool Within(int grey) const { return grey > limits_.low && grey < limits_.high; }
  bool Counts(int y, int x) const {
    return Within(a_(y, x)) && Within(b_(y, x)) && (mask_.empty() || mask_(y, x) != 0);
  }
  double Mean(int y, int x) const { return 0.5 * (a_(y, x) + b_(y, x)); }
  int Level(int y, int x) const {
    const double share = (Mean(y, x) - limits_.low) / (limits_.high - limits_.low);
    return std::clamp(static_cast<int>(share * kCoarseLevels), 0, kCoarseLevels - 1);
  }

  Parameters Row(const Tile& tile, int y, int x) const {
    const double dx = (x - tile.x0) / 32.0, dy = (y - tile.y0) / 32.0;
    const double grey = Mean(y, x) / (limits_.high + 1.0);
    Parameters row;
    row << 1, dx, dy, grey, grey * dx, grey * dy, 0.5 * (Mean(y, x + 1) - Mean(y, x - 1)),
        0.5 * (Mean(y + 1, x) - Mean(y - 1, x));
    return row;
  }

  template <typename Body>
  static void ForEachPixel(const Tile& tile, const Body& body) {
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) body(y, x);
    }
  }

  double TypicalMisfit(const Tile& tile, const Parameters& solution) const;
  void FitTile(Tile& tile);
  void FindVariances();
  void Judge(Tile& tile);
  void RejectChangedTiles();
  FrameDifference Summary() const;

  const Image<std::uint16_t>&a_, &b_;
  Image<float> residual_;
  const Image<std::uint8_t>& mask_;
  GreyLimits limits_;
  std::vector<Tile> tiles_;
  std::vector<double> variance_;  // of a difference, by coarse level
};

// From the median; not below that of rounding.
double Differencer::TypicalMisfit(const Tile& tile, const Parameters& solution) const {
  std::vector<double> misfits;
  ForEachPixel(tile, [&](int y, int x) {
    if (!Counts(y, x)) return;
    misfits.push_back(std::abs(b_(y, x) - a_(y, x) - Row(tile, y, x).dot(solution)));
  });
  constexpr double kSigmaOfMedian = 1.4826;
  return std::max(kSigmaOfMedian * Median(std::move(misfits)),
                  std::sqrt(2 * kRoundingVarianceGrey2));
}

// Fits and subtracts; after the first time without what lies far off.
void Differencer::FitTile(Tile& tile) {
  Parameters solution = Parameters::Zero();
  for (int round = 0; round < 3; ++round) {
    Eigen::Matrix<double, kParameters, kParameters> H;
    H.setZero();
    Parameters g = Parameters::Zero();
    double sum2 = 0;
    int n = 0;
    ForEachPixel(tile, [&](int y, int x) {
      if (!Counts(y, x)) return;
      const Parameters row = Row(tile, y, x);
      const double difference = b_(y, x) - a_(y, x);
      const double misfit = difference - row.dot(solution);
      if (std::abs(misfit) > tile.cut) return;
      H += row * row.transpose();
      g += row * misfit;
      sum2 += misfit * misfit;
      ++n;
    });
    tile.fitted = n;
    if (n < kFewestPixels) {
      tile.fitted = 0;
      return;
    }
    // A little stiffness, for tiles without gradients.
    H.diagonal() += Parameters::Constant(1e-9 * H.trace() + 1e-12);
    const Eigen::LDLT<Eigen::Matrix<double, kParameters, kParameters>> solver(H);
    const Parameters step = solver.solve(g);
    solution += step;
    const double s2 = std::max(0.0, sum2 - step.dot(g)) / (n - kParameters);
    tile.cut = 10 * TypicalMisfit(tile, solution);
    tile.motion_px = -solution.tail<2>();
    Parameters unit = Parameters::Zero();
    unit[kParameters - 2] = 1;
    const double var_x = solver.solve(unit)[kParameters - 2];
    unit.setZero();
    unit[kParameters - 1] = 1;
    const double var_y = solver.solve(unit)[kParameters - 1];
    tile.sigma_motion_px = std::sqrt(s2 * std::max(var_x, var_y));
  }
  const double widen = std::sqrt(static_cast<double>(tile.fitted) / (tile.fitted - kParameters));
  ForEachPixel(tile, [&](int y, int x) {
    if (!Counts(y, x)) return;
    const double difference = b_(y, x) - a_(y, x);
    residual_(y, x) = static_cast<float>(widen * (difference - Row(tile, y, x).dot(solution)));
  });
}

// The variance at each coarse level, as the median over the tiles: no line is taken for granted,
// and what moves in some tiles does not count.
void Differencer::FindVariances() {
  constexpr int kFewest = 8;
  std::vector<std::vector<double>> of_level(kCoarseLevels);
  for (const Tile& tile : tiles_) {
    if (tile.fitted == 0) continue;
    std::vector<double> sum2(kCoarseLevels, 0), count(kCoarseLevels, 0);
    ForEachPixel(tile, [&](int y, int x) {
      const double r = static_cast<double>(residual_(y, x));
      if (std::isnan(r) || std::abs(r) > tile.cut) return;
      const auto level = static_cast<std::size_t>(Level(y, x));
      sum2[level] += r * r;
      ++count[level];
    });
    for (std::size_t k = 0; k < of_level.size(); ++k) {
      if (count[k] >= kFewest) of_level[k].push_back(sum2[k] / count[k]);
    }
  }
  variance_.assign(kCoarseLevels, -1);
  for (std::size_t k = 0; k < of_level.size(); ++k) {
    if (!of_level[k].empty()) variance_[k] = Median(std::move(of_level[k]));
  }
  // A level that no tile has much of takes the nearest one's; none below that of rounding.
  const std::vector<double> known = variance_;
  for (int k = 0; k < kCoarseLevels; ++k) {
    for (int d = 0; d < kCoarseLevels && variance_[static_cast<std::size_t>(k)] < 0; ++d) {
      for (const int j : {k - d, k + d}) {
        if (j < 0 || j >= kCoarseLevels || known[static_cast<std::size_t>(j)] < 0) continue;
        variance_[static_cast<std::size_t>(k)] = known[static_cast<std::size_t>(j)];
      }
    }
    auto& variance = variance_[static_cast<std::size_t>(k)];
    variance = std::max(variance, 2 * kRoundingVarianceGrey2);
  }
}

// Takes single pixels far off out, and tells how the rest of the tile scatters.
void Differencer::Judge(Tile& tile) {
  if (tile.fitted == 0) return;
  double sum = 0;
  int n = 0, outliers = 0;
  ForEachPixel(tile, [&](int y, int x) {
    float& r = residual_(y, x);
    if (std::isnan(r)) return;
    const double variance = variance_[static_cast<std::size_t>(Level(y, x))];
    const double square = static_cast<double>(r) * static_cast<double>(r) / variance;
    if (square > kCut * kCut) {
      r = kNan;
      ++outliers;
      return;
    }
    sum += square;
    ++n;
  });
  tile.excess = n > 0 ? sum / n : 0;
  tile.changed = outliers > 0.01 * (n + outliers) || n < kFewestPixels / 2;
}

void Differencer::RejectChangedTiles() {
  std::vector<double> excess;
  for (const Tile& tile : tiles_) {
    if (tile.fitted > 0 && !tile.changed) excess.push_back(tile.excess);
  }
  const double usual = excess.empty() ? 0 : Median(std::move(excess));
  for (Tile& tile : tiles_) {
    if (tile.fitted == 0) continue;
    const double chance = 1 + 6 * std::sqrt(2.0 / tile.fitted);
    tile.changed = tile.changed || tile.excess > usual * std::max(1.3, chance);
    if (!tile.changed) continue;
    ForEachPixel(tile, [&](int y, int x) { residual_(y, x) = kNan; });
  }
}

// The displacement from a to b by phase correlation, if the frames agree better when moved by it.
double LargeMotionPx(const Image<std::uint16_t>& a, const Image<std::uint16_t>& b) {
  constexpr int kMost = 1024;
  const int width = std::min(a.width(), kMost), height = std::min(a.height(), kMost);
  if (width < 16 || height < 16) return 0;
  const int x0 = (a.width() - width) / 2, y0 = (a.height() - height) / 2;
  cv::Mat from(height, width, CV_32F), to(height, width, CV_32F), window;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      from.at<float>(y, x) = a(y0 + y, x0 + x);
      to.at<float>(y, x) = b(y0 + y, x0 + x);
    }
  }
  cv::createHanningWindow(window, from.size(), CV_32F);
  const cv::Point2d shift = cv::phaseCorrelate(from, to, window);
  const int dx = static_cast<int>(std::lround(shift.x)),
            dy = static_cast<int>(std::lround(shift.y));
  if ((dx == 0 && dy == 0) || std::abs(dx) > width / 2 || std::abs(dy) > height / 2) return 0;
  double there = 0, here = 0;
  for (int y = std::max(0, -dy); y < std::min(height, height - dy); ++y) {
    for (int x = std::max(0, -dx); x < std::min(width, width - dx); ++x) {
      const double grey = static_cast<double>(from.at<float>(y, x));
      const double moved = static_cast<double>(to.at<float>(y + dy, x + dx)) - grey;
      const double still = static_cast<double>(to.at<float>(y, x)) - grey;
      there += moved * moved;
      here += still * still;
    }
  }
  return there < 0.7 * here ? std::hypot(shift.x, shift.y) : 0;
}

FrameDifference Differencer::Summary() const {
  FrameDifference out;
  double sum_a = 0, sum_b = 0, sum_aa = 0, sum_bb = 0, sum_ab = 0;
  for (int y = 0; y < a_.height(); ++y) {
    for (int x = 0; x < a_.width(); ++x) {
      if (!mask_.empty() && mask_(y, x) == 0) continue;
      out.black += a_(y, x) <= limits_.low || b_(y, x) <= limits_.low;
      out.white += a_(y, x) >= limits_.high || b_(y, x) >= limits_.high;
      if (!Counts(y, x)) continue;
      sum_a += a_(y, x);
      sum_b += b_(y, x);
      sum_aa += static_cast<double>(a_(y, x)) * a_(y, x);
      sum_bb += static_cast<double>(b_(y, x)) * b_(y, x);
      sum_ab += static_cast<double>(a_(y, x)) * b_(y, x);
      out.identical += a_(y, x) == b_(y, x);
      ++out.counted;
    }
  }
  if (sum_a > 0) {
    const auto n = static_cast<double>(out.counted);
    out.brightness_ratio = sum_b / sum_a;
    const double var_a = sum_aa - sum_a * sum_a / n, var_b = sum_bb - sum_b * sum_b / n;
    out.likeness = (sum_ab - sum_a * sum_b / n) / std::sqrt(std::max(var_a * var_b, 1e-300));
  }
  std::vector<double> motions;
  for (const Tile& tile : tiles_) {
    if (tile.fitted == 0) continue;
    ++out.tiles;
    out.changed_tiles += tile.changed;
    // Those with texture enough to tell; noise adds its own part to the length.
    const double squared = tile.motion_px.squaredNorm();
    const double variance = tile.sigma_motion_px * tile.sigma_motion_px;
    if (tile.sigma_motion_px < 0.05 || squared > 10 * variance) {
      motions.push_back(std::sqrt(std::max(0.0, squared - 2 * variance)));
    }
  }
  if (20 * motions.size() > static_cast<std::size_t>(out.tiles)) {
    const auto at = motions.begin() + static_cast<std::ptrdiff_t>(0.9 * double(motions.size() - 1));
    std::nth_element(motions.begin(), at, motions.end());
    out.motion_px = *at;
  }
  // Where the gradients do not tell, as beyond a speckle's size, the spectrum does.
  const double large_px = LargeMotionPx(a_, b_);
  if (large_px > 0) {
    out.motion_px = large_px;
    out.likeness = 1;
  }
  out.residual = residual_;
  return out;
}

}  // namespace

GreyLimits FindGreyLimits(const GrayImage& a, const GrayImage& b) {
  const int top = std::max(a.max_level(), b.max_level());
  std::vector<std::int64_t> count(65536, 0);
  for (const GrayImage* image : {&a, &b}) {
    for (const std::uint16_t grey : image->grey.values()) ++count[grey];
  }
  std::vector<int> levels;  // that occur
  for (int grey = 0; grey < 65536; ++grey) {
    if (count[static_cast<std::size_t>(grey)] > 0) levels.push_back(grey);
  }
  const auto piles_up = [&](int level, int next, int after) {
    constexpr std::int64_t kFew = 50;
    const auto at = [&](int grey) { return count[static_cast<std::size_t>(grey)]; };
    return at(level) > kFew && at(level) > 4 * std::max(at(next), at(after));
  };
  GreyLimits limits{0, top};
  const std::size_t n = levels.size();
  if (n >= 6) {
    if (piles_up(levels[0], levels[1], levels[2])) limits.low = levels[0];
    if (piles_up(levels[n - 1], levels[n - 2], levels[n - 3])) {
      limits.high = std::min(top, levels[n - 1]);
    }
  }
  return limits;
}

FrameDifference DifferenceOfStillFrames(const GrayImage& a, const GrayImage& b,
                                        const Image<std::uint8_t>& mask, int tile_px) {
  return Differencer(a, b, mask, tile_px).Run();
}

}  // namespace plumbline::internal
