#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "calib/image.h"
#include "fit/ground_plane.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// The points of a grid that a plane was fitted to, those that are not plane.inlier left out.
struct PlanePoints {
  std::span<const Eigen::Vector3d> point_mm;
  std::span<const Eigen::Matrix3d> cov_mm2;
  std::span<const std::size_t> places;  // row * columns + column in the grid
  ImageSize grid;
};

// The random covariance of a plane fitted to points of a grid whose errors go together, in the
// order and basis of GroundPlane::cov; without the plane's scatter ratio. Of weighted least
// squares,
//   H^-1 (sum_ij J_i rho_ij J_j' / (s_i s_j)) H^-1,   H = sum_i J_i J_i' / s_i^2,
// with J_i what a turn and a shift of the plane do to the distance of point i, s_i that distance's
// sigma and rho_ij the correlation of the matches of two points (the mean over both components). A
// field has edges: one factor for all (GroundPlaneOptions) makes slopes too unsure, by a tenth for
// a dozen subsets along a side.
//
// Throws std::invalid_argument where the sizes differ.
[[nodiscard]] Eigen::Matrix3d PlaneCovariance(const GroundPlane& plane, const PlanePoints& points,
                                              const NeighbourCorrelation& neighbours);

// How the plane goes with what it was fitted to: the covariance of its error with that of the
// distance of every point of the grid, over the sigma of that distance,
//   -H^-1 sum_j rho_ij J_j / s_j,
// in the order and basis of GroundPlane::cov. A point that took part pulls the plane along.
//
// Throws as PlaneCovariance().
[[nodiscard]] Image<Eigen::Vector3d> PlaneAlongPoints(const GroundPlane& plane,
                                                      const PlanePoints& points,
                                                      const NeighbourCorrelation& neighbours);

// What the error of a plane adds to the variance of the heights of points above it (mm^2),
//   J plane.cov J' + 2 shared J along.
// It is below zero for points that the plane was fitted to: they are nearer to it than to the true
// one. NaN where a point is.
//
// point_mm: the points, in the frame of the plane. along: PlaneAlongPoints(). shared_mm: what their
// distances from the plane have in common with those that it was fitted to: the covariance of both
// over the sigma of the latter. Of these points themselves, their sigma.
// Throws std::invalid_argument where the sizes differ.
[[nodiscard]] Image<float> HeightVarianceOfPlane(const GroundPlane& plane,
                                                 const Image<Eigen::Vector3d>& point_mm,
                                                 const Image<Eigen::Vector3d>& along,
                                                 const Image<float>& shared_mm);

}  // namespace plumbline
