#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/rigid3.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// The wheel's axis when the calibration is off by one sigma of each mode.
inline std::vector<WheelAxis> AxesAlongModes(const WheelReference& wheel) {
  std::vector<WheelAxis> axes;
  for (Eigen::Index k = 0; k < wheel.axis_along_modes.rows(); ++k) {
    const Eigen::Vector4d change = wheel.axis_along_modes.row(k).transpose();
    axes.push_back({wheel.axis.rotation * RotationFromVector(change.head<3>()),
                    wheel.axis.distance_mm + change[3]});
  }
  return axes;
}

}  // namespace plumbline::internal
