#include "track/internal/local_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace plumbline::internal {
namespace {

constexpr std::size_t kFewest = 10;

}  // namespace

// Seen from it, no gap between the points is half a turn wide.
bool SurroundOrigin(const std::vector<Eigen::Vector2d>& points) {
  std::vector<double> bearings;
  for (const Eigen::Vector2d& p : points) {
    if (p.squaredNorm() == 0) return true;
    bearings.push_back(std::atan2(p.y(), p.x()));
  }
  if (bearings.empty()) return false;
  std::sort(bearings.begin(), bearings.end());
  double widest = bearings.front() + 2 * std::numbers::pi - bearings.back();
  for (std::size_t k = 1; k < bearings.size(); ++k) {
    widest = std::max(widest, bearings[k] - bearings[k - 1]);
  }
  return widest < std::numbers::pi;
}

std::vector<double> ParaboloidWeights(const std::vector<Eigen::Vector2d>& points) {
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  // A point at the origin does not surround it.
  std::vector<Eigen::Vector2d> others;
  double scale = 0;
  for (const Eigen::Vector2d& p : points) {
    if (p.squaredNorm() > 0) others.push_back(p);
    scale = std::max(scale, p.norm());
  }
  if (points.size() < kFewest || !SurroundOrigin(others)) return {};
  std::vector<Vector6> rows;
  rows.reserve(points.size());
  Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
  for (const Eigen::Vector2d& p : points) {
    const double x = p.x() / scale, y = p.y() / scale;
    Vector6 row;
    row << 1, x, y, x * x, x * y, y * y;
    normal += row * row.transpose();
    rows.push_back(row);
  }
  const Vector6 first = normal.ldlt().solve(Vector6::Unit(0));
  if (!first.allFinite()) return {};
  std::vector<double> weights;
  weights.reserve(rows.size());
  for (const Vector6& row : rows) weights.push_back(first.dot(row));
  return weights;
}

}  // namespace plumbline::internal
