#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/stereo_rig.h"
#include "fit/wheel_axis.h"
#include "track/right_delay.h"

namespace plumbline {

// Bundle adjustment of a wheel that turns in front of a rig that stands still: its axis, the angle
// of every frame and the points of its surface that explain all pixels best, and how sure each is.
//
// A point of the wheel is seen at
//   pixel = project(camera_from_rig * rotation (Ry(angle) point + distance e_z)) + noise, cov_px2
// (WheelAxis). Cameras are held; the motion is circular by construction, so that a frame has one
// unknown and not six. A point that is seen again after a full turn ties the last angle to the
// first.
//
// Minimised is the sum of squared residuals in sigmas, by Gauss-Newton with the points eliminated
// (Schur complement), exact derivatives. Cauchy weights lead to the solution, their scale falling
// with the scatter of the residuals; then plain least squares over the observations within
// outlier_sigmas of that scatter. The same normal equations give the covariance and, with the
// change of all projections along a calibration mode on their right side, what the mode does.
struct WheelObservation {
  int frame = 0;
  int point = 0;
  bool right = false;     // which camera
  Eigen::Vector2d pixel;  // raw
  Eigen::Matrix2d cov_px2 = Eigen::Matrix2d::Identity();
};

// Starting values and what was seen. The angle of the first frame that is seen is held.
struct WheelProblem {
  WheelAxis axis;
  std::vector<double> angles_rad;          // one a frame
  std::vector<Eigen::Vector3d> points_mm;  // wheel frame
  std::vector<WheelObservation> observations;
  // How far the wheel turns on in each frame until the right camera exposes, and how sure that is:
  // what one sigma of the mode late_mode of the rig does, in place of what it does to the cameras
  // (-1: none does). Empty: both expose together.
  std::vector<double> late_rad = {}, sigma_late_rad = {};
  int late_mode = -1;
};

// How fast the wheel turns in each frame, by the frames beside it (or the one; rad/s); NaN where
// the frame or both beside it have no angle or time. Sizes as given: one time an angle.
[[nodiscard]] std::vector<double> TurningSpeeds(std::span<const double> angles_rad,
                                                std::span<const double> times_s);

struct WheelAdjustmentOptions {
  double loss_scale_sigmas = 2.0;  // of Cauchy's loss, over the scatter of the residuals
  double outlier_sigmas = 4.5;
  int max_iterations = 60;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Order of axis and angles together: a rotation about the wheel's x, y and z (rad; rotation <-
// rotation exp(it)), the distance (mm), then the angle of each frame (rad). Turns about x and z
// tilt the axis; one about y moves it across the camera's view of it.
struct WheelAdjustment {
  static constexpr int kAxis = 4;  // entries before the angles

  WheelAxis axis;
  std::vector<double> angles_rad;          // NaN where a frame has no observation that counts
  std::vector<Eigen::Vector3d> points_mm;  // wheel frame; NaN where nothing determines it

  // From the noise of the observations, times the square of sigma0 where that is above 1. Rows of
  // frames without angle are NaN.
  Eigen::MatrixXd cov_random;
  std::vector<Eigen::Matrix3d> cov_points_mm2;
  // What one sigma of each calibration mode adds, to first order: row k of (K, 4 + frames), and
  // column k of (3, K). No rows where the rig has no modes.
  Eigen::MatrixXd along_modes;
  std::vector<Eigen::Matrix3Xd> points_along_modes_mm;

  std::vector<std::uint8_t> used;  // 1 or 0 an observation: not an outlier
  int outliers = 0;
  double sigma0 = 0;  // sqrt(chi2 / degrees of freedom): 1 where the given covariances are right
  double chi2 = 0;
  int degrees_of_freedom = 0;
  bool converged = false;
  int iterations = 0;

  // The random variance of sum_n derivative_n . point_n, what the points have in common by way of
  // axis and angles counted; NaN where a point is not determined. Sizes as given: one derivative
  // a point.
  double VarianceOfSum(std::span<const int> points,
                       std::span<const Eigen::Vector3d> derivatives) const;

  // How the error of a point comes about: its own, less transfer times that of entries `core` of
  // axis and angles.
  struct PointError {
    Eigen::Matrix3d own_mm2 = Eigen::Matrix3d::Zero();
    std::vector<Eigen::Index> core;
    Eigen::Matrix3Xd transfer;
  };
  std::vector<PointError> point_errors;

  Eigen::MatrixXd cov_calibration() const { return along_modes.transpose() * along_modes; }
};

// Throws InputError where an observed point is not in front of its camera at the start, and where
// axis and angles are not determined (too short an arc, too few points); std::invalid_argument for
// indices out of range and covariances that are not positive definite; UsageError from the options.
//
// The same bits for any number of threads.
// Accuracy: tests/track/wheel_adjustment_test.cc.
[[nodiscard]] WheelAdjustment AdjustWheel(const StereoRig& rig, const WheelProblem& problem,
                                          const WheelAdjustmentOptions& options = {});

// The same with a right camera that exposes later: adjusted as if it did not, which tells how fast
// the wheel turns in each frame, and again with that. times_s: of the frames. Throws InputError
// where a frame that is placed has no speed.
[[nodiscard]] WheelAdjustment AdjustLateWheel(const StereoRig& rig, WheelProblem problem,
                                              std::span<const double> times_s,
                                              const RightDelay& delay, int delay_mode,
                                              const WheelAdjustmentOptions& options = {});

}  // namespace plumbline
