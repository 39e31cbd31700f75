#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "calib/image.h"
#include "calib/median.h"

namespace plumbline::internal {

// The median of the numbers that are finite; NaN without any.
inline double MedianOfFinite(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  return values.empty() ? std::numeric_limits<double>::quiet_NaN() : Median(std::move(values));
}

// Of the components of those vectors that are whole.
inline Eigen::Vector3d Medians(const Image<Eigen::Vector3f>& vectors) {
  Eigen::Vector3d medians;
  for (int k = 0; k < 3; ++k) {
    std::vector<double> values;
    for (const Eigen::Vector3f& v : vectors.values()) {
      values.push_back(static_cast<double>(v[k]));
    }
    medians[k] = MedianOfFinite(std::move(values));
  }
  return medians;
}

}  // namespace plumbline::internal
