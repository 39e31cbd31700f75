#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// The spline through the grey levels: cubic (16 coefficients a value) or quintic (36).
enum class Interpolation : std::uint8_t { kCubic = 3, kQuintic = 5 };

// What is done to the grey levels before everything else, to take away the frequencies that no
// spline can interpolate: those of speckle with sharp edges, and noise.
enum class Prefilter : std::uint8_t {
  kNone,
  // Maximally flat low-pass of 11 taps: keeps 95 % of what has 0.2 cycles a pixel, half of what has
  // 0.31, and nothing near 0.5.
  kLowPass,
  kGaussian,
};

struct CorrelationImageOptions {
  Interpolation interpolation = Interpolation::kQuintic;
  Prefilter prefilter = Prefilter::kLowPass;  // docs/correlation.md shows what it is worth
  double gaussian_sigma_px = 0.6;             // of kGaussian

  friend bool operator==(const CorrelationImageOptions&, const CorrelationImageOptions&) = default;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// An image made ready for correlation: filtered grey levels, their gradients, and the coefficients
// of the interpolating spline. About 8 bytes a pixel, and 16 more once the gradients are asked for:
// only reference images need them. Immutable and thread-safe.
//
// Source of the spline: Unser, "Splines: a perfect fit for signal and image processing", IEEE
// Signal Processing Magazine 16(6), 1999. Borders are mirrored.
class CorrelationImage {
 public:
  // Throws UsageError as CorrelationImageOptions::Check(), InputError for an image without pixels.
  CorrelationImage(const GrayImage& image, const CorrelationImageOptions& options = {});

  ImageSize size() const { return grey_.size(); }
  int max_level() const { return max_level_; }
  const CorrelationImageOptions& options() const { return options_; }

  // At the pixels: the filtered grey levels and the exact derivatives of their spline.
  const Image<float>& grey() const { return grey_; }
  const Image<float>& gradient_x() const { return Slopes().x; }
  const Image<float>& gradient_y() const { return Slopes().y; }
  // The gradients filtered once more: the weights with which the noise of the raw pixels enters
  // sums of gradient times filtered grey level. The gradients themselves where there is no filter.
  const Image<float>& noise_gradient_x() const {
    return Filtered() ? Slopes().noise_x : Slopes().x;
  }
  const Image<float>& noise_gradient_y() const {
    return Filtered() ? Slopes().noise_y : Slopes().y;
  }

  // How many pixels at the border, or beside what a mask leaves out, are not to be used: the filter
  // and the spline mix in what lies beyond, which moves otherwise.
  int edge_px() const;

  // The spline at a place of the image, mirrored beyond it. Slow: for checks, not for correlation.
  double Value(const Eigen::Vector2d& pixel) const;

  // The share of white noise's variance that is left in the grey level at fractions (x, y) of a
  // pixel, after the filter and the interpolation.
  double NoiseShare(double fraction_x, double fraction_y) const;
  // Its mean over all fractions.
  double MeanNoiseShare() const;

  // Spline coefficients, with a mirrored margin of kMargin on all sides: the one of pixel (x, y) is
  // at [y * stride + x].
  static constexpr int kMargin = 24;
  const float* coefficients() const {
    return coefficients_.data() + kMargin * static_cast<std::ptrdiff_t>(stride_) + kMargin;
  }
  std::ptrdiff_t stride() const { return stride_; }
  int degree() const { return static_cast<int>(options_.interpolation); }

 private:
  struct Gradients {
    std::once_flag once;
    Image<float> x, y, noise_x, noise_y;
  };
  bool Filtered() const { return options_.prefilter != Prefilter::kNone; }
  const Gradients& Slopes() const;  // worked out at the first call

  CorrelationImageOptions options_;
  int max_level_ = 255;
  Image<float> grey_;
  std::unique_ptr<Gradients> gradients_ = std::make_unique<Gradients>();
  std::ptrdiff_t stride_ = 0;
  std::vector<float> coefficients_;
  std::vector<double> noise_energy_;  // along one axis, by fraction of a pixel, 0 to 1
};

}  // namespace plumbline
