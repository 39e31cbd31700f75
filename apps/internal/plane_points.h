#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "track/surface_plane.h"
#include "track/surface_state.h"

namespace plumbline::internal {

// The points of a surface in every `stride`-th row and column: far enough apart that a plane does
// not gain by more of them.
struct PointsOfPlane {
  // cov_px2: as of CovarianceOf().
  PointsOfPlane(const SurfaceState& in_rig, const Image<Eigen::Vector3f>& cov_px2, int stride);

  std::vector<std::size_t> places;  // row * columns + column
  std::vector<Eigen::Vector3d> point_mm;
  std::vector<Eigen::Matrix3d> cov_mm2;
  ImageSize grid;

  PlanePoints All() const { return {point_mm, cov_mm2, places, grid}; }
};

}  // namespace plumbline::internal
