#include "track/surface_plane.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/parallel.h"

namespace plumbline {
namespace {

// What a turn and a shift of the plane do to the distance of a point.
Eigen::Vector3d DistanceJacobian(const GroundPlane& plane, const Eigen::Vector3d& point_mm) {
  const Eigen::Vector3d q = point_mm - plane.centroid;
  return {-plane.e2.dot(q), plane.e1.dot(q), -1};
}

// J_i / s_i of the points that a plane was fitted to, and what follows from it.
class WhitenedFit {
 public:
  WhitenedFit(const GroundPlane& plane, const PlanePoints& points,
              const NeighbourCorrelation& neighbours)
      : neighbours_(neighbours), whitened_(points.grid, Eigen::Vector3d::Zero()) {
    const std::size_t count = points.point_mm.size();
    if (points.cov_mm2.size() != count || points.places.size() != count ||
        plane.inlier.size() != count) {
      throw std::invalid_argument("the points of a plane: lists of different length");
    }
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    for (std::size_t n = 0; n < count; ++n) {
      const double variance = plane.normal.dot(points.cov_mm2[n] * plane.normal);
      if (plane.inlier[n] == 0 || !(variance > 0)) continue;
      Eigen::Vector3d& J = whitened_.data()[points.places[n]];
      J = DistanceJacobian(plane, points.point_mm[n]) / std::sqrt(variance);
      normal += J * J.transpose();
    }
    inverse_ = normal.ldlt().solve(Eigen::Matrix3d::Identity());
  }

  bool TookPart(int row, int column) const { return !whitened_(row, column).isZero(0); }
  const Eigen::Vector3d& At(int row, int column) const { return whitened_(row, column); }
  const Eigen::Matrix3d& inverse() const { return inverse_; }  // H^-1

  // sum_j rho_ij J_j / s_j.
  Eigen::Vector3d About(int row, int column) const {
    const ImageSize grid = whitened_.size();
    const int reach = neighbours_.reach();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int y = std::max(0, row - reach); y <= std::min(grid.height - 1, row + reach); ++y) {
      for (int x = std::max(0, column - reach); x <= std::min(grid.width - 1, column + reach);
           ++x) {
        if (!TookPart(y, x)) continue;
        const Eigen::Matrix2f R = neighbours_.Between(row, column, y - row, x - column);
        sum += 0.5 * static_cast<double>(R.trace()) * whitened_(y, x);
      }
    }
    return sum;
  }

 private:
  const NeighbourCorrelation& neighbours_;
  Image<Eigen::Vector3d> whitened_;  // zero where there is no inlier
  Eigen::Matrix3d inverse_;
};

}  // namespace

Eigen::Matrix3d PlaneCovariance(const GroundPlane& plane, const PlanePoints& points,
                                const NeighbourCorrelation& neighbours) {
  const WhitenedFit fit(plane, points, neighbours);
  Eigen::Matrix3d noise = Eigen::Matrix3d::Zero();
  for (int r = 0; r < points.grid.height; ++r) {
    for (int c = 0; c < points.grid.width; ++c) {
      if (fit.TookPart(r, c)) noise += fit.At(r, c) * fit.About(r, c).transpose();
    }
  }
  return fit.inverse() * (0.5 * (noise + noise.transpose())) * fit.inverse();
}

Image<Eigen::Vector3d> PlaneAlongPoints(const GroundPlane& plane, const PlanePoints& points,
                                        const NeighbourCorrelation& neighbours) {
  const WhitenedFit fit(plane, points, neighbours);
  Image<Eigen::Vector3d> along(points.grid, Eigen::Vector3d::Zero());
  const auto columns = static_cast<std::size_t>(points.grid.width);
  ForEachIndex(along.pixel_count(), [&](std::size_t i) {
    along.data()[i] =
        -fit.inverse() * fit.About(static_cast<int>(i / columns), static_cast<int>(i % columns));
  });
  return along;
}

Image<float> HeightVarianceOfPlane(const GroundPlane& plane, const Image<Eigen::Vector3d>& point_mm,
                                   const Image<Eigen::Vector3d>& along,
                                   const Image<float>& shared_mm) {
  if (along.size() != point_mm.size() || shared_mm.size() != point_mm.size()) {
    throw std::invalid_argument("HeightVarianceOfPlane: images of different size");
  }
  Image<float> added(point_mm.size(), std::numeric_limits<float>::quiet_NaN());
  ForEachIndex(added.pixel_count(), [&](std::size_t i) {
    const Eigen::Vector3d J = DistanceJacobian(plane, point_mm.data()[i]);
    const double common = static_cast<double>(shared_mm.data()[i]) * J.dot(along.data()[i]);
    added.data()[i] = static_cast<float>(J.dot(plane.cov * J) + 2 * common);
  });
  return added;
}

}  // namespace plumbline
