#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

namespace plumbline {

// Smooths an angle that was measured frame by frame, with the angular speed, over the whole
// recording.
//
// Model: the third derivative of the angle is white noise of density q (the wheel's speed changes
// smoothly), the state (angle, speed, acceleration); with dt between two frames
//   x <- [1 dt dt^2/2; 0 1 dt; 0 0 1] x + w,
//   cov(w) = q [dt^5/20 dt^4/8 dt^3/6; . dt^3/3 dt^2/2; . . dt]
// (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
// section 6.2.3). All states follow from one least-squares problem (fixed-interval smoothing).
// Nothing is assumed of where and how fast the wheel starts.
//
// Outliers are found by what the other frames say of a frame (leave-one-out), with q from the
// leave-one-out likelihood under a heavy-tailed density (Student's t of 4 degrees of freedom), so
// that they do not hide behind it. They do not count: the result there is of the others alone.
// Then q, and by how much the angles scatter more than they claim, follow by maximum likelihood of
// the innovations.
//
// Turns from frame to frame that something else measures, as an encoder does, are observations of
// the same problem, x_i+1 - x_i = turn + noise: right however the wheel moves in between. They tell
// nothing of the angle itself; the measured angles do. Where the errors of these drift from frame
// to frame, as over an obstacle that draws the whole surface along, the drift is a fourth entry of
// the state that walks at random, from nothing in the first frame: it does not average out.
//
// Times may lie unevenly. Units: rad and s (where times are in another unit, that).
struct AngleSmootherOptions {
  // Root of q; left out: estimated. 0: constant acceleration.
  std::optional<double> jerk_rad_s25;  // rad / s^2.5
  double outlier_sigmas = 5;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Between each frame and the next: one less than there are frames.
struct AngleTurns {
  std::vector<double> turn_rad, sigma_rad;  // NaN where none was measured; empty: none was
  // One sigma of what the common error of the measured angles changes by. Empty: it does not.
  std::vector<double> drift_rad;
  Eigen::MatrixXd along_rad;  // (K, turns), small changes of the turns with one cause each
};

struct SmoothedAngle {
  double angle_rad = 0, speed_rad_s = 0;
  double sigma_angle_rad = 0, sigma_speed_rad_s = 0;  // random
  double sigma_turn_rad = 0;  // of the angle less that of the first frame that was measured
  // How much the result leans on the smoother: 1 less its derivative by the angle measured in this
  // frame. 1 where none was, or where it is an outlier.
  double lean = 1;
  bool outlier = false;
  bool turn_outlier = false;  // the turn to the next frame does not count
};

struct SmoothedAngles {
  std::vector<SmoothedAngle> frames;
  double jerk_rad_s25 = 0;
  // By how much the angles, with the turns, scatter more than their sigmas say; never below 1. The
  // sigmas above count it. 1 where there are less than kEnoughForScatter of them to tell.
  double scatter = 1;
  // Of the smoothed angles and speeds, one row a row of `along`.
  Eigen::MatrixXd angle_along_rad, speed_along_rad_s;
  // The same for AngleTurns::along_rad.
  Eigen::MatrixXd angle_along_turns_rad, speed_along_turns_rad_s;

  static constexpr int kEnoughForScatter = 10;
};

// times_s: growing. angles_rad: NaN where none was measured; unwrapped. sigmas_rad: of each, from
// independent noise. along: (K, frames), small changes of the measured angles that have one cause
// each, such as calibration modes (NaN counts as 0): they go through the smoother as the angles do.
// Throws std::invalid_argument for sizes that do not fit, times that do not grow, sigmas that are
// not positive and drifts below 0; UsageError from the options.
// Accuracy: tests/track/angle_smoother_test.cc.
[[nodiscard]] SmoothedAngles SmoothAngles(std::span<const double> times_s,
                                          std::span<const double> angles_rad,
                                          std::span<const double> sigmas_rad,
                                          const Eigen::MatrixXd& along,
                                          const AngleSmootherOptions& options = {},
                                          const AngleTurns& turns = {});

}  // namespace plumbline
