#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace plumbline::internal {

// Rays that differ less than this (rad) are parallel: far below what a pixel's noise does to a ray.
inline constexpr double kParallel_rad = 1e-9;

// Distances along the two unit rays to the feet of their common perpendicular; false where the rays
// are parallel or a foot lies behind its camera, or anything is NaN. f0 from the origin, f1 from
// `centre`, all in one frame (mm).
inline bool CommonPerpendicular(const Eigen::Vector3d& f0, const Eigen::Vector3d& f1,
                                const Eigen::Vector3d& centre, double* depth0, double* depth1) {
  const Eigen::Vector3d n = f0.cross(f1);
  const double n2 = n.squaredNorm();
  if (!(n2 > kParallel_rad * kParallel_rad)) return false;
  *depth0 = centre.cross(f1).dot(n) / n2;
  *depth1 = centre.cross(f0).dot(n) / n2;
  return *depth0 > 0 && *depth1 > 0;
}

}  // namespace plumbline::internal
