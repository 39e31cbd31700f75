#include "track/right_flow.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "calib/triangulate.h"
#include "track/internal/still_modes.h"
#include "track/internal/survey_grid.h"
#include "track/surface_state.h"

namespace plumbline {
namespace {

const Eigen::Vector3d kNowhere =
    Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());

// Linear between the places of the profile; NaN beyond them.
double RadiusAt(const WheelProfile& profile, double y_mm) {
  const auto next = std::upper_bound(profile.y_mm.begin(), profile.y_mm.end(), y_mm);
  if (next == profile.y_mm.begin() || next == profile.y_mm.end()) return kNowhere.x();
  const auto k = static_cast<std::size_t>(next - profile.y_mm.begin());
  const double share = (y_mm - profile.y_mm[k - 1]) / (profile.y_mm[k] - profile.y_mm[k - 1]);
  return std::lerp(profile.radius_mm[k - 1], profile.radius_mm[k], share);
}

// Where the ray of a pixel meets the undeformed wheel from within (rig frame); NaN where the
// profile does not reach.
Eigen::Vector3d UnderLeftPixel(const WheelReference& wheel, const Eigen::Vector2d& px) {
  const Rigid3 wheel_from_rig = wheel.axis.RigFromWheel(0).Inverse();
  const Eigen::Vector3d ray = wheel.rig.left.Unproject(px).normalized();
  const Eigen::Vector3d from = wheel_from_rig.translation_mm, along = wheel_from_rig.rotation * ray;
  const auto beyond = [&](double way_mm) {
    const Eigen::Vector3d at = from + way_mm * along;
    return std::hypot(at.x(), at.z()) - RadiusAt(wheel.profile, at.y());
  };
  // From step to step to where the ray leaves the wheel, then by halves.
  constexpr double kStep_mm = 1;
  double inside = -1, outside = -1;
  for (double way = 0; way < 2 * wheel.profile.crown_radius_mm && outside < 0; way += kStep_mm) {
    const double off = beyond(way);
    if (off < 0) inside = way;
    if (off >= 0 && inside >= 0) outside = way;
  }
  // A gap in between: out of the profile's reach.
  if (outside < 0 || outside - inside > 1.5 * kStep_mm) return kNowhere;
  constexpr int kHalves = 30;
  for (int k = 0; k < kHalves; ++k) {
    const double middle = (inside + outside) / 2;
    (beyond(middle) < 0 ? inside : outside) = middle;
  }
  return inside * ray;
}

}  // namespace

RightFlow::RightFlow(const WheelReference& wheel, const StereoField& pair)
    : left_px_(pair.left.size(),
               Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN())) {
  const StereoSurface surface = TriangulateField(wheel.rig, pair, UnitCovariance(pair, pair));
  const Eigen::Vector3d axis = wheel.axis.direction_in_rig(),
                        origin = wheel.axis.origin_in_rig_mm();
  for (int r = 0; r < left_px_.height(); ++r) {
    for (int c = 0; c < left_px_.width(); ++c) {
      const Eigen::Vector3d p = surface.status(r, c) == Status::kOk
                                    ? surface.instant.point_mm(r, c)
                                    : UnderLeftPixel(wheel, pair.left.PixelOf(r, c));
      if (!p.allFinite()) continue;
      const Camera::Projection seen = wheel.rig.left.ProjectWithJacobians(p);
      left_px_(r, c) = seen.d_pixel_d_point * axis.cross(p - origin);
    }
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
    if (flow.allFinite()) {
      right->displacement_px.data()[i] += by * flow;
    } else if (by != 0 && right->status.data()[i] == Status::kOk) {
      right->status.data()[i] = Status::kExtrapolated;
    }
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
