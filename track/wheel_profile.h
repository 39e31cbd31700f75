#pragma once

#include <vector>

#include "track/wheel_adjustment.h"

namespace plumbline {

// The mean cross-section of a wheel: distance from the axis by place along it (wheel frame). Each
// entry is the mean over the points of a bin of kBin_mm, at their mean place; bins with fewer than
// kFewest points are left out.
struct WheelProfile {
  std::vector<double> y_mm, radius_mm;
  std::vector<double> sigma_random_mm, sigma_calibration_mm;
  std::vector<double> scatter_mm;  // rms of the points about it: out of round, and their noise
  std::vector<int> points;
  // Its top: the vertex of a parabola through the points within kCrown_mm of the largest radius.
  // NaN where that lies at the edge of what is seen.
  double crown_radius_mm = 0, crown_y_mm = 0;
  double sigma_crown_random_mm = 0, sigma_crown_calibration_mm = 0;

  static constexpr double kBin_mm = 5, kCrown_mm = 15;
  static constexpr int kFewest = 8;
};

// Errors that points have in common (axis, angles, calibration) are counted: they do not average
// out. Sigmas from the calibration are NaN where the rig has no modes.
[[nodiscard]] WheelProfile ProfileOf(const WheelAdjustment& adjusted);

}  // namespace plumbline
