#pragma once

#include <Eigen/Core>
#include <cmath>

namespace plumbline::internal {

// Standard deviation along the longest axis of a covariance's ellipse.
inline double WorstSigma(const Eigen::Matrix2d& covariance) {
  const double half_difference = (covariance(0, 0) - covariance(1, 1)) / 2;
  return std::sqrt(covariance.trace() / 2 + std::hypot(half_difference, covariance(0, 1)));
}

}  // namespace plumbline::internal
