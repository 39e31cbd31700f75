#include "track/right_flow.h"

#include <limits>
#include <vector>

#include "calib/triangulate.h"
#include "track/internal/still_modes.h"
#include "track/internal/survey_grid.h"
#include "track/surface_state.h"

namespace plumbline {

RightFlow::RightFlow(const WheelReference& wheel, const StereoField& pair)
    : left_px_(pair.left.size(),
               Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN())) {
  const StereoSurface surface = TriangulateField(wheel.rig, pair, UnitCovariance(pair, pair));
  const Eigen::Vector3d axis = wheel.axis.direction_in_rig(),
                        origin = wheel.axis.origin_in_rig_mm();
  for (std::size_t i = 0; i < left_px_.pixel_count(); ++i) {
    if (surface.status.data()[i] != Status::kOk) continue;
    const Eigen::Vector3d& p = surface.instant.point_mm.data()[i];
    const Camera::Projection seen = wheel.rig.left.ProjectWithJacobians(p);
    left_px_.data()[i] = seen.d_pixel_d_point * axis.cross(p - origin);
  }
}

Image<Eigen::Vector2d> RightFlow::Of(const PlanarField& right) const {
  Image<Eigen::Vector2d> flow = left_px_;
  for (std::size_t i = 0; i < flow.pixel_count(); ++i) {
    const Eigen::Matrix2f& gradient = right.gradient.data()[i];
    // Subsets of order 0 have none.
    if (gradient.allFinite()) flow.data()[i] += gradient.cast<double>() * left_px_.data()[i];
  }
  return flow;
}

RightFlow RightFlow::Every(int stride) const {
  RightFlow thinned;
  thinned.left_px_ = internal::EveryOf(left_px_, stride);
  return thinned;
}

void MoveAlong(const Image<Eigen::Vector2d>& flow_px, double by, PlanarField* right) {
  for (std::size_t i = 0; i < flow_px.pixel_count(); ++i) {
    const Eigen::Vector2d& flow = flow_px.data()[i];
    if (flow.allFinite()) right->displacement_px.data()[i] += by * flow;
  }
}

Eigen::Vector2d RigidRightFlow(const WheelReference& wheel, const Eigen::Vector3d& in_rig_mm) {
  const Rigid3& right_from_left = wheel.rig.right_from_left;
  const Camera::Projection seen = wheel.rig.right.ProjectWithJacobians(right_from_left * in_rig_mm);
  return seen.d_pixel_d_point * right_from_left.rotation *
         wheel.axis.direction_in_rig().cross(in_rig_mm - wheel.axis.origin_in_rig_mm());
}

void FillModeOfMatches(const StereoRig& rig, std::span<const Eigen::Vector2d> left,
                       std::span<const Eigen::Vector2d> right,
                       std::span<const Eigen::Vector2d> right_px, std::size_t mode,
                       std::span<Eigen::Vector3f> moved) {
  if (left.empty()) return;
  std::vector<Eigen::Vector2d> there(right.begin(), right.end());
  for (std::size_t i = 0; i < there.size(); ++i) there[i] += right_px[i];
  const std::vector<Eigen::Vector3d> from = TriangulatePoints(rig, left, right),
                                     to = TriangulatePoints(rig, left, there);
  const std::size_t modes = moved.size() / left.size();
  for (std::size_t i = 0; i < from.size(); ++i) {
    moved[i * modes + mode] = (to[i] - from[i]).cast<float>();
  }
}

WheelReference WithDelayMode(WheelReference wheel, const RightDelay& delay) {
  delay.Check();
  if (delay.sigma_s > 0 && wheel.delay_mode < 0) {
    wheel.delay_mode = wheel.rig.modes.count();
    internal::AppendStillModes(1, "the right camera's delay", &wheel);
  }
  return wheel;
}

}  // namespace plumbline
