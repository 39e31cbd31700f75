#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "calib/image.h"
#include "fit/ground_plane.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// The random covariance of a plane fitted to points of a grid whose errors go together, in the
// order and basis of GroundPlane::cov; without the plane's scatter ratio. Of weighted least
// squares,
//   H^-1 (sum_ij J_i rho_ij J_j' / (s_i s_j)) H^-1,   H = sum_i J_i J_i' / s_i^2,
// with J_i what a turn and a shift of the plane do to the distance of point i, s_i that distance's
// sigma and rho_ij the correlation of the matches of two points (the mean over both components). A
// field has edges: one factor for all (GroundPlaneOptions) makes slopes too unsure, by a tenth for
// a dozen subsets along a side.
//
// places: row * columns + column of each point in the grid; points that are not plane.inlier are
// left out. Throws std::invalid_argument where the sizes differ.
[[nodiscard]] Eigen::Matrix3d PlaneCovariance(const GroundPlane& plane,
                                              std::span<const Eigen::Vector3d> points_mm,
                                              std::span<const Eigen::Matrix3d> cov_mm2,
                                              std::span<const std::size_t> places, ImageSize grid,
                                              const NeighbourCorrelation& neighbours);

}  // namespace plumbline
