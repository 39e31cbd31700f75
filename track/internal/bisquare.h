#pragma once

#include <cmath>

namespace plumbline::internal {

// Tukey's bisquare weight of a residual: 1 at 0, 0 from the scale on.
inline double Bisquare(double residual, double scale) {
  const double x = residual / scale;
  return std::abs(x) < 1 ? (1 - x * x) * (1 - x * x) : 0;
}

}  // namespace plumbline::internal
