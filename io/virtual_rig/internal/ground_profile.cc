#include "io/virtual_rig/internal/ground_profile.h"

#include <algorithm>
#include <limits>
#include <numbers>

#include "calib/error.h"

namespace plumbline {
namespace {

// The ridge of an angle iron is blunt over twice this width.
constexpr double kRidge_mm = 2;

}  // namespace

double Obstacle::Height() const {
  switch (section) {
    case Section::kSquare:
      return size_mm;
    case Section::kAngleIron:
      return size_mm / std::numbers::sqrt2 - kRidge_mm;
    default:
      return height_mm;
  }
}

namespace internal {
namespace {

constexpr double kSqrt2 = std::numbers::sqrt2;

Eigen::Vector2d Across(const Obstacle& obstacle) {
  if (obstacle.section == Obstacle::Section::kNut) return {0, 0};
  return {std::cos(obstacle.angle_rad), std::sin(obstacle.angle_rad)};
}

// Half the width on the ground (radius of the circumscribed circle of a nut).
double HalfWidth(const Obstacle& obstacle) {
  switch (obstacle.section) {
    case Obstacle::Section::kSquare:
      return obstacle.size_mm / 2;
    case Obstacle::Section::kAngleIron:
      return obstacle.size_mm / kSqrt2;
    default:
      return obstacle.size_mm / std::numbers::sqrt3;
  }
}

// Greatest distance (mm) beyond one of the six sides; negative inside the nut.
double DistanceFromHexagon(const Eigen::Vector2d& p, const Obstacle& nut) {
  double distance = -nut.size_mm;
  for (int k = 0; k < 3; ++k) {
    const double a = nut.angle_rad + k * std::numbers::pi / 3;
    distance =
        std::max(distance, std::abs(p.x() * std::cos(a) + p.y() * std::sin(a)) - nut.size_mm / 2);
  }
  return distance;
}

double HeightOf(const Obstacle& obstacle, const Eigen::Vector2d& ground) {
  const Eigen::Vector2d p = ground - obstacle.centre_mm;
  if (obstacle.section == Obstacle::Section::kNut) {
    return DistanceFromHexagon(p, obstacle) <= 0 ? obstacle.height_mm : 0;
  }
  const double x = std::abs(p.dot(Across(obstacle)));
  if (obstacle.section == Obstacle::Section::kSquare) {
    return x <= obstacle.size_mm / 2 ? obstacle.size_mm : 0;
  }
  return std::max(0.0, HalfWidth(obstacle) - std::max(x, kRidge_mm));
}

}  // namespace

GroundProfile::GroundProfile(std::vector<Obstacle> obstacles, double bending_length_mm)
    : obstacles_(std::move(obstacles)) {
  for (const Obstacle& obstacle : obstacles_) {
    const double height = obstacle.Height();
    if (!(obstacle.size_mm > 0) || !(height > 0)) {
      throw UsageError("An obstacle's size and height must be positive.");
    }
    Bump bump{obstacle.centre_mm,
              Across(obstacle),
              HalfWidth(obstacle),
              2 * std::sqrt(height * bending_length_mm),
              height,
              0};
    // A flank of slope p is longer than its plan by sqrt(1 + p^2) - 1, close to 0.35 p^2 up to
    // 45 degrees; the mean of p^2 over SmoothStep is 10 / 7 (height / flank)^2. Two thirds of it
    // are drawn in, the rest is stretch (around a nut, where gathering makes hoop strain, half of
    // that): otherwise material would be crowded where the tyre hangs free of the flank.
    bump.gathered = (bump.across.isZero() ? 0.17 : 0.34) * height * height / bump.flank;
    if (obstacle.section == Obstacle::Section::kAngleIron) bump.plateau = kRidge_mm;
    for (const Bump& other : bumps_) {
      const bool bars = !bump.across.isZero() && !other.across.isZero();
      const Eigen::Vector2d way = bump.centre - other.centre;
      const double distance = bars ? std::abs(way.dot(bump.across)) : way.norm();
      const double reach = bump.plateau + bump.flank + other.plateau + other.flank;
      if (distance < reach || (bars && std::abs(bump.across.dot(other.across)) < 1 - 1e-12)) {
        throw UsageError(
            "Two obstacles are so near to each other that the tyre would touch both at once; put "
            "them further apart.");
      }
    }
    bumps_.push_back(bump);
  }
}

double GroundProfile::Height(const Eigen::Vector2d& ground) const {
  double height = 0;
  for (const Obstacle& obstacle : obstacles_) height = std::max(height, HeightOf(obstacle, ground));
  return height;
}

double GroundProfile::Bridging(const Eigen::Vector2d& ground) const {
  double bridging = -std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < bumps_.size(); ++k) {
    const Bump& bump = bumps_[k];
    const Eigen::Vector2d p = ground - bump.centre;
    const double distance = bump.across.isZero() ? p.norm() : std::abs(p.dot(bump.across));
    double beyond_top = distance - bump.plateau;
    if (obstacles_[k].section == Obstacle::Section::kNut) {
      beyond_top = DistanceFromHexagon(p, obstacles_[k]);
    }
    bridging = std::max(bridging, std::min(beyond_top, bump.plateau + bump.flank - distance));
  }
  return bridging;
}

}  // namespace internal
}  // namespace plumbline
