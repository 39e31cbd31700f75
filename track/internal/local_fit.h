#pragma once

#include <Eigen/Core>
#include <vector>

namespace plumbline::internal {

// Whether the origin lies inside of the convex hull of points.
bool SurroundOrigin(const std::vector<Eigen::Vector2d>& points);

// Weights of sum 1 by which values at points give that of the least-squares paraboloid at the
// origin. Empty where there are fewer than ten points or they do not surround it.
std::vector<double> ParaboloidWeights(const std::vector<Eigen::Vector2d>& points);

}  // namespace plumbline::internal
