#include "track/surface_plane.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace plumbline {

Eigen::Matrix3d PlaneCovariance(const GroundPlane& plane,
                                std::span<const Eigen::Vector3d> points_mm,
                                std::span<const Eigen::Matrix3d> cov_mm2,
                                std::span<const std::size_t> places, ImageSize grid,
                                const NeighbourCorrelation& neighbours) {
  if (cov_mm2.size() != points_mm.size() || places.size() != points_mm.size() ||
      plane.inlier.size() != points_mm.size()) {
    throw std::invalid_argument("PlaneCovariance: lists of different length");
  }
  // J_i / s_i; zero where there is no inlier.
  Image<Eigen::Vector3d> whitened(grid, Eigen::Vector3d::Zero());
  for (std::size_t n = 0; n < points_mm.size(); ++n) {
    const double variance = plane.normal.dot(cov_mm2[n] * plane.normal);
    if (plane.inlier[n] == 0 || !(variance > 0)) continue;
    const Eigen::Vector3d q = points_mm[n] - plane.centroid;
    whitened.data()[places[n]] =
        Eigen::Vector3d(-plane.e2.dot(q), plane.e1.dot(q), -1) / std::sqrt(variance);
  }
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), noise = Eigen::Matrix3d::Zero();
  const int reach = neighbours.reach();
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      const Eigen::Vector3d& J = whitened(r, c);
      if (J.isZero(0)) continue;
      normal += J * J.transpose();
      Eigen::Vector3d about = Eigen::Vector3d::Zero();
      for (int y = std::max(0, r - reach); y <= std::min(grid.height - 1, r + reach); ++y) {
        for (int x = std::max(0, c - reach); x <= std::min(grid.width - 1, c + reach); ++x) {
          const Eigen::Vector3d& other = whitened(y, x);
          if (other.isZero(0)) continue;
          about +=
              0.5 * static_cast<double>(neighbours.Between(r, c, y - r, x - c).trace()) * other;
        }
      }
      noise += J * about.transpose();
    }
  }
  const Eigen::Matrix3d inverse = normal.ldlt().solve(Eigen::Matrix3d::Identity());
  return inverse * (0.5 * (noise + noise.transpose())) * inverse;
}

}  // namespace plumbline
