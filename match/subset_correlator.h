#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "match/correlation_image.h"
#include "match/noise_model.h"
#include "match/subset_warp.h"

namespace plumbline {

enum class SubsetShape : std::uint8_t { kSquare, kCircle };

struct CorrelatorOptions {
  int subset_px = 33;  // side or diameter, odd, 5 to 255
  SubsetShape shape = SubsetShape::kSquare;
  int order = 1;              // of the shape function: 0, 1 or 2
  int max_iterations = 20;    // sums over the deformed image
  double stop_px = 0.001;     // rms shift of the subset's pixels that a further step would make
  double min_zncc = 0.6;      // below: low_correlation
  double max_sigma_px = 0.3;  // of the displacement, in its worst direction; above: low_texture
  // Of the subset's pixels, inside of image and mask: below, the point is masked or outside_image.
  // (Those within CorrelationImage::edge_px() of either's edge are inside, but not used.)
  double min_pixel_share = 0.5;
  // Noise of the images. Without it the residual of each subset tells, which counts what the model
  // does not explain as noise.
  std::optional<NoiseModel> noise;
  std::optional<NoiseModel> deformed_noise;  // of the deformed images, where it is another's

  // Throws UsageError naming the broken constraint.
  void Check() const;
  int radius_px() const { return subset_px / 2; }
};

// One subset found again in the deformed image. NaN where status is not kOk, but for what the
// search ended with: zncc, iterations and, where that left the image, the warp.
struct SubsetMatch {
  Status status = Status::kNotConverged;
  SubsetWarp warp = {Eigen::Matrix<double, 2, 6>::Constant(kNone)};
  Eigen::Matrix2d cov_displacement_px2 = Eigen::Matrix2d::Constant(kNone);  // deformed image
  Eigen::Matrix4d cov_gradient = Eigen::Matrix4d::Constant(kNone);  // du/dx, du/dy, dv/dx, dv/dy
  double zncc = kNone;
  double noise_grey = kNone;       // standard deviation of a raw pixel that the sigmas are based on
  double reference_share = kNone;  // of the variances, what is due to the reference's noise
  int iterations = 0;

  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
};

// Inverse-compositional Gauss-Newton on the ZNSSD criterion: finds subsets of the reference image
// in deformed images.
//
// Model: g(W(x)) = gain f(x) + offset over the pixels x of the subset, W the warp, f and g the
// splines. Every step solves the linear least-squares problem for shape terms, gain and offset
// together (Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 56(3), 2004, section 3.2, with
// gain and offset projected out) and composes the warp with the inverse of the result; where that
// makes things worse the step is damped (Levenberg-Marquardt). The gradients are the reference's,
// so that noise of the deformed image does not bias the result.
//
// Covariance: the estimate is linear in the noise of both images, delta = H^-1 sum_k J(k) n(k),
// with the pre-filter's effect on both sides; so cov = H^-1 (sum J J' var n) H^-1, where the
// weights of raw pixels are the gradients filtered once more. With white noise and no filter this
// is the Cramer-Rao bound with gain and offset unknown. Rounding to whole levels counts as noise.
// That is in the pixels of the reference; with F = 1 + gradient the displacement in the deformed
// image has the covariance F cov F', and of the deformed image's noise, seen from the reference,
// there is 1 / det F times as much, since its pixels are more or fewer.
//
// Thread-safe; the images must outlive it.
// Accuracy: tests/match/noise_limit_test.cc, docs/correlation.md.
class SubsetCorrelator {
 public:
  // mask: of the reference, 0 for pixels that do not count; null: all do. Throws UsageError as
  // CorrelatorOptions::Check(), InputError when the subset is larger than the image or the mask of
  // another size.
  SubsetCorrelator(const CorrelationImage& reference, const CorrelatorOptions& options,
                   const Image<std::uint8_t>* mask = nullptr);
  ~SubsetCorrelator();

  const CorrelatorOptions& options() const;

  // Works out what does not depend on the deformed image for the subsets around these pixels, once
  // and for all (2 KB each): matches of them are about half as long after that, and the same. Not
  // to be called while others match.
  void Remember(const std::vector<Eigen::Vector2i>& pixels);

  // Finds the subset around a pixel of the reference (x, y), starting from a warp. With order 0 or
  // 1 the second order of that is kept as it is: what is known of the curvature beforehand. Where
  // the reference or the mask cuts the subset off, what is left of it is looked for; all of that
  // has to lie inside the deformed image. Throws std::invalid_argument when the deformed image was
  // not prepared with the reference's options.
  SubsetMatch Match(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                    const SubsetWarp& start) const;

  // Zero-normalised cross-correlation of the subset with the deformed image under a warp; NaN where
  // that leaves the image.
  double Zncc(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
              const SubsetWarp& warp) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
