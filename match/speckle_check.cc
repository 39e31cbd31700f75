#include "match/speckle_check.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/error.h"
#include "match/internal/frame_difference.h"
#include "match/internal/speckle_advice.h"
#include "match/internal/speckle_spectrum.h"
#include "match/internal/worst_sigma.h"

namespace plumbline {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
// Of the variance of a pixel, in that of the five-point difference: (1 + 64 + 64 + 1) / 144.
constexpr double kGradientNoise = 65.0 / 72.0;
constexpr int kReach = 2;                 // of that difference
constexpr double kFewestOfSubset = 0.25;  // of its pixels must be there
constexpr double kAboveNoise = 5;         // sigmas of the gradient energy that noise alone has
constexpr double kNoiseUnsure = 0.05;     // of that energy, where the noise is told,
constexpr double kEstimateUnsure = 0.25;  // and where it is estimated from the image

// Value at a share of the sorted values; they must not be empty.
double Quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// Sums over pixels that a subset is made of.
struct SubsetSums {
  Eigen::Matrix2d energy = Eigen::Matrix2d::Zero();    // of g g'
  Eigen::Matrix2d weighted = Eigen::Matrix2d::Zero();  // of v g g'
  double variance = 0, variance2 = 0;                  // of v, of v^2
  int pixels = 0;
};

// Covariance of the displacement; nothing where the gradients are not above the noise in every
// direction.
std::optional<Eigen::Matrix2d> Covariance(const SubsetSums& sums, double noise_unsure) {
  const Eigen::Matrix2d H =
      sums.energy - kGradientNoise * sums.variance * Eigen::Matrix2d::Identity();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(H, Eigen::EigenvaluesOnly);
  const double chance = kAboveNoise * kGradientNoise * std::sqrt(2 * sums.variance2);
  const double unsure = noise_unsure * kGradientNoise * sums.variance;
  if (!(eigen.eigenvalues()[0] > chance + unsure)) return std::nullopt;
  // Noise of the gradients meets that of the other image only: with its own it sums to nothing, as
  // the difference about a pixel does not hold the pixel.
  const Eigen::Matrix2d scattered =
      2 * sums.weighted - kGradientNoise * sums.variance2 * Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d inverse = H.inverse();
  return Eigen::Matrix2d(inverse * scattered * inverse);
}

class Checker {
 public:
  Checker(const GrayImage& image, const SpeckleCheckOptions& options,
          const Image<std::uint8_t>& mask)
      : image_(image), options_(options), mask_(mask) {}

  SpeckleCheck Run() {
    Levels();
    FindNoise();
    Spectrum();
    Gradients();
    PlacePois();
    tbb::parallel_for(std::size_t{0}, out_.pois.size(),
                      [&](std::size_t i) { CheckPoi(out_.pois[i]); });
    Summarise();
    internal::FindWeakRegions(options_, image_.size(), columns_, out_);
    internal::AddSpeckleAdvice(options_, image_.bits, out_);
    return std::move(out_);
  }

 private:
  bool Wanted(int y, int x) const { return mask_.empty() || mask_(y, x) != 0; }
  double Variance(int y, int x) const {
    return out_.noise.Variance(image_.grey(y, x)) + kRoundingVarianceGrey2;
  }

  void Levels();
  void FindNoise();
  void Spectrum();
  void Gradients();
  void PlacePois();
  void Add(int y, int x, SubsetSums& sums) const;
  void CheckPoi(SpecklePoi& poi) const;
  void Summarise();

  const GrayImage& image_;
  const SpeckleCheckOptions& options_;
  const Image<std::uint8_t>& mask_;
  SpeckleCheck out_;
  Image<Eigen::Vector2f> gradient_;  // NaN at the border
  int columns_ = 0;                  // of POIs
};

void Checker::Levels() {
  const internal::GreyLimits limits = internal::FindGreyLimits(image_, image_);
  double sum = 0, sum2 = 0;
  int lowest = 65536, highest = -1;
  std::int64_t black = 0, white = 0;
  for (int y = 0; y < image_.height(); ++y) {
    for (int x = 0; x < image_.width(); ++x) {
      if (!Wanted(y, x)) continue;
      const int grey = image_.grey(y, x);
      ++out_.pixels;
      sum += grey;
      sum2 += static_cast<double>(grey) * grey;
      black += grey <= limits.low;
      white += grey >= limits.high;
      lowest = std::min(lowest, grey);
      highest = std::max(highest, grey);
    }
  }
  if (out_.pixels == 0) throw InputError("The mask leaves no pixel of the image to look at.");
  if (lowest == highest) {
    throw InputError(fmt::format("The image has no texture: all pixels have the grey level {}{}.",
                                 lowest,
                                 lowest >= image_.max_level() ? ", which is white: expose shorter"
                                 : lowest == 0 ? ", which is black: is the lens covered?"
                                               : ""));
  }
  const auto n = static_cast<double>(out_.pixels);
  out_.mean_grey = sum / n;
  out_.contrast_grey =
      sum2 / n - out_.mean_grey * out_.mean_grey;  // its square, until noise is known
  out_.black_share = static_cast<double>(black) / n;
  out_.white_share = static_cast<double>(white) / n;
}

void Checker::FindNoise() {
  out_.noise_estimated = !options_.noise.has_value();
  out_.noise = options_.noise.value_or(
      NoiseModel{out_.noise_estimated ? EstimateNoiseVariance(image_, mask_) : 0, 0});
  const double variance = out_.noise.Variance(out_.mean_grey) + kRoundingVarianceGrey2;
  out_.contrast_grey = std::sqrt(std::max(0.0, out_.contrast_grey - variance));
}

void Checker::Spectrum() {
  const internal::TileSpectrum spectrum(image_, mask_);
  const double variance = out_.noise.Variance(out_.mean_grey) + kRoundingVarianceGrey2;
  out_.feature_px = spectrum.FeatureSizePx(variance);
  out_.blur_px = spectrum.BlurPx(variance, out_.feature_px);
}

// With (1, -8, 0, 8, -1) / 12: within 1 % of the true gradient down to periods of 6 px.
void Checker::Gradients() {
  const Eigen::Vector2f none = Eigen::Vector2f::Constant(std::numeric_limits<float>::quiet_NaN());
  gradient_ = Image<Eigen::Vector2f>(image_.size(), none);
  const auto difference = [](double before2, double before, double after, double after2) {
    return static_cast<float>((before2 - 8 * before + 8 * after - after2) / 12);
  };
  tbb::parallel_for(kReach, image_.height() - kReach, [&](int y) {
    for (int x = kReach; x < image_.width() - kReach; ++x) {
      const auto at = [&](int dy, int dx) {
        return static_cast<double>(image_.grey(y + dy, x + dx));
      };
      gradient_(y, x) = {difference(at(0, -2), at(0, -1), at(0, 1), at(0, 2)),
                         difference(at(-2, 0), at(-1, 0), at(1, 0), at(2, 0))};
    }
  });
  double length = 0, noise = 0, energy = 0;
  std::int64_t n = 0;
  for (int y = 0; y < image_.height(); ++y) {
    for (int x = 0; x < image_.width(); ++x) {
      const Eigen::Vector2f g = gradient_(y, x);
      if (!Wanted(y, x) || std::isnan(g.x())) continue;
      length += static_cast<double>(g.norm());
      energy += static_cast<double>(g.squaredNorm());
      noise += 2 * kGradientNoise * Variance(y, x);
      ++n;
    }
  }
  if (n == 0) return;
  // As if noise lengthened all gradients in one proportion.
  out_.mean_gradient_grey = length / static_cast<double>(n) *
                            std::sqrt(std::max(0.0, 1 - noise / std::max(energy, 1e-300)));
}

void Checker::PlacePois() {
  const int half = options_.subset_px / 2;
  const int step = options_.step_px > 0 ? options_.step_px : std::max(1, half);
  const int across = image_.width() - options_.subset_px,
            down = image_.height() - options_.subset_px;
  columns_ = across / step + 1;
  for (int y = half + (down % step) / 2; y + half < image_.height(); y += step) {
    for (int c = 0; c < columns_; ++c) {
      SpecklePoi poi;
      poi.centre_px = {half + (across % step) / 2 + c * step, y};
      poi.cov_px2.setConstant(kNan);
      poi.sigma_px = kNan;
      out_.pois.push_back(poi);
    }
  }
}

void Checker::Add(int y, int x, SubsetSums& sums) const {
  if (y < 0 || x < 0 || y >= image_.height() || x >= image_.width() || !Wanted(y, x)) return;
  ++sums.pixels;
  const Eigen::Vector2d g = gradient_(y, x).cast<double>();
  if (std::isnan(g.x())) return;
  const double v = Variance(y, x);
  const Eigen::Matrix2d gg = g * g.transpose();
  sums.energy += gg;
  sums.weighted += v * gg;
  sums.variance += v;
  sums.variance2 += v * v;
}

// Grows a square about the POI, ring by ring.
void Checker::CheckPoi(SpecklePoi& poi) const {
  const int cx = poi.centre_px.x(), cy = poi.centre_px.y();
  if (!Wanted(cy, cx)) {
    poi.status = Status::kMasked;
    return;
  }
  const int half = options_.subset_px / 2;
  SubsetSums sums;
  Add(cy, cx, sums);
  for (int r = 1; r <= options_.largest_subset_px / 2; ++r) {
    for (int x = cx - r; x <= cx + r; ++x) {
      Add(cy - r, x, sums);
      Add(cy + r, x, sums);
    }
    for (int y = cy - r + 1; y < cy + r; ++y) {
      Add(y, cx - r, sums);
      Add(y, cx + r, sums);
    }
    const bool last = poi.smallest_subset_px > 0 && r > half;
    if (last) break;
    const std::optional<Eigen::Matrix2d> cov =
        Covariance(sums, out_.noise_estimated ? kEstimateUnsure : kNoiseUnsure);
    const double sigma = cov ? internal::WorstSigma(*cov) : kNan;
    if (poi.smallest_subset_px == 0 && sigma <= options_.wanted_sigma_px) {
      poi.smallest_subset_px = 2 * r + 1;
    }
    if (r != half) continue;
    if (sums.pixels < kFewestOfSubset * options_.subset_px * options_.subset_px) {
      poi.status = Status::kMasked;
      return;
    }
    if (!cov) continue;
    poi.status = Status::kOk;
    poi.cov_px2 = *cov;
    poi.sigma_px = sigma;
  }
}

void Checker::Summarise() {
  std::vector<double> sigmas, subsets;
  for (const SpecklePoi& poi : out_.pois) {
    if (poi.status == Status::kMasked) continue;
    if (poi.status == Status::kOk) sigmas.push_back(poi.sigma_px);
    subsets.push_back(poi.smallest_subset_px > 0 ? poi.smallest_subset_px : 1e9);
  }
  if (subsets.empty()) {
    throw InputError(fmt::format(
        "No subset of {} px has its middle and enough of its pixels in the mask or region: take a "
        "larger one.",
        options_.subset_px));
  }
  out_.measurable_pois = static_cast<std::int64_t>(sigmas.size());
  out_.median_sigma_px = sigmas.empty() ? kNan : Quantile(sigmas, 0.5);
  out_.sigma95_px = sigmas.empty() ? kNan : Quantile(sigmas, 0.95);
  const double subset = Quantile(std::move(subsets), 0.95);
  out_.subset_for_wanted_px = subset < 1e9 ? static_cast<int>(subset) : 0;
}

// Residual variances of quadratic fits to 5x5 windows that hold no clipped pixel.
std::vector<double> WindowVariances(const GrayImage& image, const Image<std::uint8_t>& mask) {
  constexpr int kSide = 5, kPixels = kSide * kSide, kTerms = 6;
  Eigen::Matrix<double, kPixels, kTerms> basis;
  for (int i = 0; i < kPixels; ++i) {
    const double x = i % kSide - 2, y = i / kSide - 2;
    basis.row(i) << 1 / std::sqrt(25.0), x / std::sqrt(50.0), y / std::sqrt(50.0), x * y / 10,
        (x * x - 2) / std::sqrt(70.0), (y * y - 2) / std::sqrt(70.0);
  }
  const internal::GreyLimits limits = internal::FindGreyLimits(image, image);
  std::vector<double> variances;
  for (int y0 = 0; y0 + kSide <= image.height(); y0 += kSide) {
    for (int x0 = 0; x0 + kSide <= image.width(); x0 += kSide) {
      Eigen::Matrix<double, kPixels, 1> grey;
      bool good = true;
      for (int i = 0; i < kPixels && good; ++i) {
        const int y = y0 + i / kSide, x = x0 + i % kSide;
        grey[i] = image.grey(y, x);
        good = grey[i] > limits.low && grey[i] < limits.high && (mask.empty() || mask(y, x) != 0);
      }
      if (!good) continue;
      const double rest = (grey - basis * (basis.transpose() * grey)).squaredNorm();
      variances.push_back(rest / (kPixels - kTerms));
    }
  }
  return variances;
}

}  // namespace

void SpeckleCheckOptions::Check() const {
  const auto odd = [](int side, const char* what) {
    if (side < 5 || side > 501 || side % 2 == 0) {
      throw UsageError(
          fmt::format("{} must be an odd number of px from 5 to 501, not {}.", what, side));
    }
  };
  odd(subset_px, "The subset");
  odd(largest_subset_px, "The largest subset");
  if (largest_subset_px < subset_px) {
    throw UsageError("The largest subset must not be smaller than the subset.");
  }
  if (step_px < 0) throw UsageError("The step between POIs must be 0 or more px.");
  if (!(wanted_sigma_px > 0)) throw UsageError("The wanted sigma must be positive.");
}

double EstimateNoiseVariance(const GrayImage& image, const Image<std::uint8_t>& mask) {
  double least = internal::TileSpectrum(image, mask).FloorGrey2();
  std::vector<double> windows = WindowVariances(image, mask);
  constexpr std::size_t kFewestWindows = 50;
  if (windows.size() >= kFewestWindows) {
    // The tenth part of chi2 with 19 degrees of freedom lies below 11.65.
    const double flattest = Quantile(std::move(windows), 0.1) * 19 / 11.65;
    least = std::isnan(least) ? flattest : std::min(least, flattest);
  }
  return std::isnan(least) ? 0 : std::max(0.0, least - kRoundingVarianceGrey2);
}

SpeckleCheck CheckSpeckle(const GrayImage& image, const SpeckleCheckOptions& options,
                          const Image<std::uint8_t>& mask) {
  options.Check();
  if (image.width() < options.subset_px || image.height() < options.subset_px) {
    throw InputError(fmt::format("The image of {}x{} px is smaller than the subset of {} px.",
                                 image.width(), image.height(), options.subset_px));
  }
  if (!mask.empty() && !(mask.size() == image.size())) {
    throw InputError(fmt::format("The mask is {}x{} px and the image {}x{} px.", mask.width(),
                                 mask.height(), image.width(), image.height()));
  }
  return Checker(image, options, mask).Run();
}

}  // namespace plumbline
