#include "match/correlation_image.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/error.h"
#include "match/internal/bspline.h"

namespace plumbline {
namespace {

using namespace internal;  // NOLINT(google-build-using-namespace): our own folder's

constexpr int kFractions = 32;  // of a pixel, in the table of noise energies

// The taps of a function of the fraction at fraction 0, centred on the pixel.
std::vector<float> TapsAtPixel(int degree, void (*weights_of)(int, double, double*)) {
  double weights[6];
  weights_of(degree, 0, weights);
  std::vector<float> taps;
  for (int k = 0; k < degree; ++k) taps.push_back(static_cast<float>(weights[k]));
  return taps;
}

std::vector<float> TapsOf(const CorrelationImageOptions& options) {
  switch (options.prefilter) {
    case Prefilter::kNone:
      return {1.0F};
    case Prefilter::kGaussian:
      return GaussianTaps(options.gaussian_sigma_px);
    default:
      return LowPassTaps();
  }
}

}  // namespace

void CorrelationImageOptions::Check() const {
  if (interpolation != Interpolation::kCubic && interpolation != Interpolation::kQuintic) {
    throw UsageError("The interpolation is cubic or quintic.");
  }
  if (prefilter == Prefilter::kGaussian && !(gaussian_sigma_px > 0 && gaussian_sigma_px <= 5)) {
    throw UsageError(fmt::format(
        "The Gaussian pre-filter's standard deviation is above 0 up to 5 px; {} px is not.",
        gaussian_sigma_px));
  }
}

CorrelationImage::CorrelationImage(const GrayImage& image, const CorrelationImageOptions& options)
    : options_(options), max_level_(image.max_level()) {
  options_.Check();
  if (image.grey.empty()) throw InputError("An image without pixels cannot be correlated.");
  const int width = image.width();
  const int height = image.height();
  Image<float> raw(image.size());
  std::transform(image.grey.values().begin(), image.grey.values().end(), raw.values().begin(),
                 [](std::uint16_t level) { return static_cast<float>(level); });
  const std::vector<float> filter = TapsOf(options_);
  grey_ = Filtered() ? FilterSeparably(raw, filter, filter) : std::move(raw);
  Image<float> coefficients = grey_;
  SamplesToCoefficients(degree(), coefficients);
  stride_ = width + 2 * kMargin;
  coefficients_.resize(static_cast<std::size_t>(stride_) *
                       static_cast<std::size_t>(height + 2 * kMargin));
  for (int y = -kMargin; y < height + kMargin; ++y) {
    const float* from = coefficients.row(Mirrored(y, height));
    float* to = coefficients_.data() + (y + kMargin) * stride_ + kMargin;
    std::copy(from, from + width, to);
    for (int k = 1; k <= kMargin; ++k) {
      to[-k] = from[Mirrored(-k, width)];
      to[width - 1 + k] = from[Mirrored(width - 1 + k, width)];
    }
  }
  for (int i = 0; i <= kFractions; ++i) {
    noise_energy_.push_back(NoiseEnergy(degree(), filter, static_cast<double>(i) / kFractions));
  }
}

const CorrelationImage::Gradients& CorrelationImage::Slopes() const {
  Gradients& gradients = *gradients_;
  std::call_once(gradients.once, [&] {
    Image<float> plain(size());
    for (int y = 0; y < plain.height(); ++y) {
      std::copy_n(coefficients() + y * stride_, plain.width(), plain.row(y));
    }
    const std::vector<float> value = TapsAtPixel(degree(), SplineWeights);
    const std::vector<float> slope = TapsAtPixel(degree(), SplineSlopeWeights);
    gradients.x = FilterSeparably(plain, slope, value);
    gradients.y = FilterSeparably(plain, value, slope);
    if (!Filtered()) return;
    const std::vector<float> filter = TapsOf(options_);
    gradients.noise_x = FilterSeparably(gradients.x, filter, filter);
    gradients.noise_y = FilterSeparably(gradients.y, filter, filter);
  });
  return gradients;
}

// Where the error of subsets at the border, of rendered images, is down to that of all others.
int CorrelationImage::edge_px() const {
  const int of_spline = options_.interpolation == Interpolation::kCubic ? 2 : 3;
  switch (options_.prefilter) {
    case Prefilter::kNone:
      return of_spline;
    case Prefilter::kGaussian:
      return std::max(of_spline, 1 + static_cast<int>(std::ceil(2.5 * options_.gaussian_sigma_px)));
    default:
      return 4;
  }
}

double CorrelationImage::Value(const Eigen::Vector2d& pixel) const {
  const double x0 = std::floor(pixel.x());
  const double y0 = std::floor(pixel.y());
  double along_x[6];
  double along_y[6];
  SplineWeights(degree(), pixel.x() - x0, along_x);
  SplineWeights(degree(), pixel.y() - y0, along_y);
  const int before = (degree() - 1) / 2;
  double value = 0;
  for (int j = 0; j <= degree(); ++j) {
    const int y = Mirrored(static_cast<int>(y0) - before + j, grey_.height());
    double row = 0;
    for (int i = 0; i <= degree(); ++i) {
      const int x = Mirrored(static_cast<int>(x0) - before + i, grey_.width());
      row += along_x[i] * static_cast<double>(coefficients()[y * stride_ + x]);
    }
    value += along_y[j] * row;
  }
  return value;
}

double CorrelationImage::NoiseShare(double fraction_x, double fraction_y) const {
  const auto along = [&](double fraction) {
    const double at = std::clamp(fraction - std::floor(fraction), 0.0, 1.0) * kFractions;
    const auto i = std::min(static_cast<std::size_t>(at), std::size_t{kFractions - 1});
    const double t = at - static_cast<double>(i);
    return (1 - t) * noise_energy_[i] + t * noise_energy_[i + 1];
  };
  return along(fraction_x) * along(fraction_y);
}

double CorrelationImage::MeanNoiseShare() const {
  const double mean =
      std::accumulate(noise_energy_.begin(), noise_energy_.end() - 1, 0.0) / kFractions;
  return mean * mean;
}

}  // namespace plumbline
