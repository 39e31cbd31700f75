#include "apps/internal/surface_points.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "calib/parallel.h"
#include "calib/triangulate.h"

namespace plumbline::internal {
namespace {

// Observations are large; they are made and used up in blocks.
constexpr std::size_t kBlock = 1 << 17;

struct Wanted {
  std::size_t grid_index;
  Eigen::Vector2d rectified_left;
  double disparity_px, sigma_px;
};

std::vector<Wanted> WantedMatches(const DisparityMap& disparity, const MeasurementGrid& grid,
                                  Image<Status>& status) {
  std::vector<Wanted> wanted;
  status = grid.status;
  for (int r = 0; r < grid.use.height(); ++r) {
    for (int c = 0; c < grid.use.width(); ++c) {
      if (grid.use(r, c) == 0) continue;
      const int x = grid.x0 + c * grid.step_px;
      const int y = grid.y0 + r * grid.step_px;
      status(r, c) = disparity.status(y, x);
      if (status(r, c) != Status::kOk) continue;
      wanted.push_back({static_cast<std::size_t>(r) * static_cast<std::size_t>(grid.use.width()) +
                            static_cast<std::size_t>(c),
                        Eigen::Vector2d(x, y), static_cast<double>(disparity.value_px(y, x)),
                        static_cast<double>(disparity.sigma_px(y, x))});
    }
  }
  return wanted;
}

}  // namespace

RawMatch MatchFromDisparity(const Rectification& rectification,
                            const Eigen::Vector2d& rectified_left, const Eigen::Vector2d& raw_left,
                            double disparity_px, double sigma_px) {
  RawMatch match;
  match.left = raw_left;
  Eigen::Matrix2d d_raw_d_rectified;
  match.right = rectification.RightRawPixel({rectified_left.x() - disparity_px, rectified_left.y()},
                                            &d_raw_d_rectified);
  const Eigen::Vector2d along = d_raw_d_rectified.col(0) * sigma_px;
  match.cov_px2.setZero();
  match.cov_px2.bottomRightCorner<2, 2>() = along * along.transpose();
  return match;
}

SurfacePoints TriangulateDisparity(const StereoRig& rig, const Rectification& rectification,
                                   const DisparityMap& disparity, const MeasurementGrid& grid,
                                   Image<Status>& status) {
  const std::vector<Wanted> wanted = WantedMatches(disparity, grid, status);
  SurfacePoints points;
  points.grid_index.reserve(wanted.size());
  points.left.reserve(wanted.size());
  points.right.reserve(wanted.size());
  points.point_in_rig.reserve(wanted.size());
  points.cov_mm2.reserve(wanted.size());
  std::vector<StereoObservation> observations;
  for (std::size_t begin = 0; begin < wanted.size(); begin += kBlock) {
    const std::size_t count = std::min(kBlock, wanted.size() - begin);
    observations.resize(count);
    ForEachIndex(count, [&](std::size_t i) {
      const Wanted& w = wanted[begin + i];
      const RawMatch match =
          MatchFromDisparity(rectification, w.rectified_left, grid.raw_left.values()[w.grid_index],
                             w.disparity_px, w.sigma_px);
      observations[i] = {match.left, match.right, match.cov_px2};
    });
    const std::vector<TriangulatedPoint> triangulated = Triangulate(rig, observations);
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t grid_index = wanted[begin + i].grid_index;
      status.values()[grid_index] = triangulated[i].status;
      if (triangulated[i].status != Status::kOk) continue;
      points.grid_index.push_back(grid_index);
      points.left.push_back(observations[i].left);
      points.right.push_back(observations[i].right);
      points.point_in_rig.push_back(triangulated[i].point_in_rig);
      points.cov_mm2.push_back(triangulated[i].cov_mm2);
    }
  }
  return points;
}

Rigid3 BestRigidMotion(const std::vector<Eigen::Vector3d>& from,
                       const std::vector<Eigen::Vector3d>& to) {
  const std::size_t stride = std::max<std::size_t>(1, from.size() / 20000);
  Eigen::Matrix3Xd a(3, static_cast<Eigen::Index>(from.size() / stride + 1));
  Eigen::Matrix3Xd b(a.rows(), a.cols());
  Eigen::Index count = 0;
  for (std::size_t i = 0; i < from.size(); i += stride) {
    if (!from[i].allFinite() || !to[i].allFinite()) continue;
    a.col(count) = from[i];
    b.col(count) = to[i];
    ++count;
  }
  if (count < 3) return {};
  const Eigen::Matrix4d motion = Eigen::umeyama(a.leftCols(count), b.leftCols(count), false);
  return {motion.topLeftCorner<3, 3>(), motion.topRightCorner<3, 1>()};
}

}  // namespace plumbline::internal
