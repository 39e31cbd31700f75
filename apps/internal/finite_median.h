#pragma once

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "calib/median.h"

namespace plumbline::internal {

// The median of the numbers that are finite; NaN without any.
inline double MedianOfFinite(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  return values.empty() ? std::numeric_limits<double>::quiet_NaN() : Median(std::move(values));
}

}  // namespace plumbline::internal
