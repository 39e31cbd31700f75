#pragma once

#include <Eigen/Core>
#include <vector>

#include "track/wheel_reference.h"

namespace plumbline::internal {

// The wheel's axis when the calibration is off by one sigma of each mode.
inline std::vector<WheelAxis> AxesAlongModes(const WheelReference& wheel) {
  std::vector<WheelAxis> axes;
  for (Eigen::Index k = 0; k < wheel.axis_along_modes.rows(); ++k) {
    axes.push_back(wheel.axis.Off(wheel.axis_along_modes.row(k).transpose()));
  }
  return axes;
}

}  // namespace plumbline::internal
