#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "track/surface_state.h"

namespace plumbline {

// How far points moved, and how sure. All images have the size of the grid; NaN where a point is
// missing at either instant.
struct SurfaceMotion {
  Image<Eigen::Vector3d> value_mm;
  // From independent noise, and what subsets leave out: mm^2, xx xy xz yy yz zz.
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2;
  Image<Eigen::Vector3f> sigma_calibration_mm;  // NaN where the modes are unknown
};

// From one instant to another, both in the same frame. All four matches are counted, with the noise
// of the reference subset that they share; what subsets leave out at either end; and what each
// calibration mode does to both.
[[nodiscard]] SurfaceMotion MotionBetween(const SurfaceState& from, const SurfaceState& to,
                                          const Image<Eigen::Vector3f>& cov_px2);

// The random covariance of the points of one instant (mm^2, xx xy xz yy yz zz), and their sigmas
// from the calibration.
[[nodiscard]] Image<Eigen::Matrix<float, 6, 1>> CovarianceOf(const SurfaceState& instant,
                                                             const Image<Eigen::Vector3f>& cov_px2);
[[nodiscard]] Image<Eigen::Vector3f> CalibrationSigma(const SurfaceState& instant);

// The rigid motion of the whole surface: to = motion * from, by least squares over the points that
// both instants hold, all with the same weight (Umeyama, PAMI 1991, without scale).
struct SurfaceRigidMotion {
  bool found = false;  // false: fewer than three points, or all on one line
  Rigid3 motion;       // of the frame's origin
  Eigen::Vector3d about_mm = Eigen::Vector3d::Zero();  // centroid of the points before
  // Order: rotation vector (rad), translation of the centroid (mm): nearly independent.
  Eigen::Matrix<double, 6, 6> cov_random = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 6> cov_calibration = Eigen::Matrix<double, 6, 6>::Zero();
  // What one sigma of each calibration mode adds, in that order. Empty: unknown.
  std::vector<Eigen::Matrix<double, 6, 1>> along_modes;
  double rms_mm = 0;  // of what is left
};

// correlation_area_points: how many neighbouring points share one noise (GroundPlaneOptions).
// random: the motion's covariances.
[[nodiscard]] SurfaceRigidMotion RigidMotionBetween(const SurfaceState& from,
                                                    const SurfaceState& to,
                                                    const SurfaceMotion& motion,
                                                    double correlation_area_points);

// What is left of a motion when the rigid one is undone: motion^-1 * to - from. The rigid motion's
// own random covariance is added to that of the points.
[[nodiscard]] SurfaceMotion WithoutRigidMotion(const SurfaceState& from, const SurfaceState& to,
                                               const SurfaceMotion& motion,
                                               const SurfaceRigidMotion& rigid);

}  // namespace plumbline
