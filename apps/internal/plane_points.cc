#include "apps/internal/plane_points.h"

#include "track/surface_motion.h"

namespace plumbline::internal {

PointsOfPlane::PointsOfPlane(const SurfaceState& in_rig, const Image<Eigen::Vector3f>& cov_px2,
                             int stride)
    : grid(in_rig.size()) {
  const auto cov = plumbline::CovarianceOf(in_rig, cov_px2);
  for (int r = 0; r < grid.height; r += stride) {
    for (int c = 0; c < grid.width; c += stride) {
      if (!in_rig.point_mm(r, c).allFinite()) continue;
      places.push_back(static_cast<std::size_t>(r) * static_cast<std::size_t>(grid.width) +
                       static_cast<std::size_t>(c));
      point_mm.push_back(in_rig.point_mm(r, c));
      cov_mm2.push_back(plumbline::CovarianceOf(cov(r, c)));
    }
  }
}

}  // namespace plumbline::internal
