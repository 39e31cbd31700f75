#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "match/neighbour_correlation.h"
#include "track/planar_strain.h"
#include "track/strain_measure.h"
#include "track/surface_state.h"

namespace plumbline {

// A line in the frame of the points; the direction need not have length one.
struct LineInSpace {
  Eigen::Vector3d point_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitY();
};

struct SurfaceStrainOptions {
  StrainMeasure measure = StrainMeasure::kGreenLagrange;
  int window_points = 9;  // side of the gauge, odd, 3 or more
  int order = 1;          // of the polynomial, 1 to 3
  // Of the gauge's points; of the inverse of their mean variance in the reference.
  GaugeWeights weights = GaugeWeights::kEqual;
  // As of PlanarStrainOptions: no one-sided extrapolation at edges and holes.
  double min_share = 0.7;
  double min_quarter_share = 0.25;
  // e1, the local x axis: the projection onto the tangent plane of the reference surface of this
  // direction (in the frame of the points), or of growing columns of the grid.
  std::optional<Eigen::Vector3d> x_direction;
  // Or: of the direction in which the point goes when it turns about this line, as on a wheel. Not
  // both. An error of the line turns all axes alike and is not in the sigmas.
  std::optional<LineInSpace> x_around;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The strain of a surface within its tangent planes: all images have the size of the grid, NaN
// where status is not kOk. Strains have no unit. Sigmas are one standard deviation, first order:
// `random` from the noise of the images, `calibration` from the rig's (NaN where its modes are not
// known). They differ in kind: the first averages out over points, the second does not.
struct SurfaceStrain {
  StrainMeasure measure = StrainMeasure::kGreenLagrange;
  int window_points = 0;
  int order = 1;
  int vsg_px = 0;     // side of the virtual strain gauge: (window_points - 1) step + subset
  double vsg_mm = 0;  // on the reference surface: the median over it; NaN without a surface

  // (xx, yy, xy), xy the tensor's component, in the axes e1, e2 (see SurfaceGauges).
  Image<Eigen::Vector3f> strain;
  Image<Eigen::Matrix<float, 6, 1>> cov_strain;  // random; upper triangle, row by row
  Image<Eigen::Vector3f> sigma_calibration;      // of strain
  // As StrainInvariants; the angle turns from e1 towards e2. Their sigmas hold where those of
  // PlanarStrain do.
  Image<Eigen::Vector2f> principal;
  Image<Eigen::Vector2f> sigma_principal_random, sigma_principal_calibration;
  Image<float> angle_rad, sigma_angle_random_rad, sigma_angle_calibration_rad;
  Image<float> max_shear, sigma_max_shear_random, sigma_max_shear_calibration;
  Image<float> von_mises, sigma_von_mises_random, sigma_von_mises_calibration;
  Image<std::uint16_t> points;  // that went into the gauge
  Image<Status> status;

  SurfaceStrain() = default;
  explicit SurfaceStrain(ImageSize size);
  ImageSize size() const { return status.size(); }
};

// Strain of a curved surface in space over virtual strain gauges: window_points x window_points
// points about each point of the grid. What is the same in all frames is worked out once.
//
// Over the gauge's valid points, those of the reference X that are there now, X and the points now,
// x, are fitted by polynomials of the order in the pixels of the reference image, with weights of 1
// or the inverse of the mean of uu and vv of cov_px2. Their gradients at the centre, A and a (3x2),
// are tangents of both surfaces:
//   T = [e1 e2]' A,  F = [f1 f2]' a T^-1,  strain = StrainOf(F - 1, measure).
// Both fits are the same linear filter, so that a rigid motion has no strain however curved the
// surface is (kSmall: without turning about the normal).
//
// Axes:  the normal n points towards the camera that sees columns to the right and rows downwards;
//        e1 see x_direction and x_around; e2 = n x e1. Along columns, e2 points against growing
//        rows, so that xy has the opposite sign of PlanarStrain's. (f1, f2) are (e1, e2) turned by
//        the smallest rotation that takes n to the deformed normal.
// Random covariance:  with Gamma_m (2x2) the error of the gradient of match m over the gauge and D
//        = d_left, d_right at its centre,
//          dA = sum D Gamma (reference),  da = sum D Gamma (now),
//          cov(Gamma_m, Gamma_n) = rho_mn s_m s_n C,  rho_mm = 1,  rho_mn = (share_m share_n)^1/2,
//        C being the covariance of the gradient of a planar gauge with full overlap of the subsets
//        (ComputePlanarStrain). dF is exact to first order, the axes' own turn included; that D and
//        s vary over the gauge enters in second order of their relative change. The reference
//        itself as `now` is the same matches once more: with shares of 1 its sigma is zero, with
//        others that of a repetition.
// Calibration:  each mode changes all points at once, dA_k and da_k are the same fits of
//        along_modes_mm, and sigma^2 = sum_k (d strain_k)^2.
class SurfaceGauges {
 public:
  // reference: at the reference instant. cov_px2: covariance (uu, uv, vv) of a match at each point
  // for a scale of 1, in pixels of the reference image. neighbours: of that image and this grid.
  // A point of the reference is used where point_mm and cov_px2 are finite.
  //
  // Throws: UsageError from options.Check(); InputError where images differ in size or the step or
  //         subset is below 1 px.
  SurfaceGauges(SurfaceState reference, Image<Eigen::Vector3f> cov_px2,
                NeighbourCorrelation neighbours, int step_px, int subset_px,
                const SurfaceStrainOptions& options = {});

  // The strain now; status: of the points now.
  //
  // Status:  that of the point where it is not kOk; kExtrapolated where the gauge is not full
  //          enough (see the options) or its points do not fix the polynomial; kFailedVerification
  //          where the reference has no point, the point is not finite, the gauge has no tangent
  //          plane or no e1 (its direction normal to it), or the covariance is not finite.
  // Throws:  InputError where images differ in size from the grid, or the modes in number from the
  //          reference's (none on either side is allowed: sigma_calibration is then NaN).
  // Thread-safe; the result does not depend on the number of threads. Where no point of the
  // reference is missing now, it costs the fits alone; else also a little for each missing point.
  [[nodiscard]] SurfaceStrain Strain(const SurfaceState& now, const Image<Status>& status) const;

  // Columns e1, e2 and n of the gauges of the reference; NaN where they are not full enough.
  [[nodiscard]] Image<Eigen::Matrix3f> axes() const;

 private:
  struct State;
  std::shared_ptr<const State> state_;
};

}  // namespace plumbline
