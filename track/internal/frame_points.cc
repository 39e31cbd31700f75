#include "track/internal/frame_points.h"

#include <cmath>
#include <limits>
#include <utility>

#include "track/right_drift.h"
#include "track/right_flow.h"

namespace plumbline::internal {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
const Eigen::Vector3d kNowhere = Eigen::Vector3d::Constant(kNone);

}  // namespace

FramePoints PointsOfFrames::Of(std::size_t f, const CarcassThickness& carcass) const {
  const RollingFrame& frame = rolling_.frames[f];
  const ImageSize size = rolling_.grid;
  FramePoints out;
  out.now.point_mm = out.undeformed.point_mm = out.material =
      Image<Eigen::Vector3d>(size, kNowhere);
  out.now.cov_random_mm2 = out.undeformed.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(size, Eigen::Matrix<float, 6, 1>::Zero());
  out.cov_mm2 = Image<Eigen::Matrix3d>(size, Eigen::Matrix3d::Constant(kNone));
  const Rigid3 rig_from_wheel = reference_.axis.RigFromWheel(frame.angle_rad);
  std::vector<Eigen::Vector2d> left, right;
  for (const RollingPoint& p : frame.points) {
    const int r = p.at.y(), c = p.at.x();
    out.now.point_mm(r, c) = p.point_mm;
    out.now.cov_random_mm2(r, c) = p.cov_random_mm2;
    out.cov_mm2(r, c) = CovarianceOf(p.cov_random_mm2);
    out.undeformed.point_mm(r, c) = rig_from_wheel * p.undeformed_mm;
    out.undeformed.cov_random_mm2(r, c) =
        TriangleOf(Eigen::Matrix3d(rig_from_wheel.rotation * CovarianceOf(p.cov_undeformed_mm2) *
                                   rig_from_wheel.rotation.transpose()));
    out.material(r, c) = {MaterialAngle(p.undeformed_mm), p.undeformed_mm.y(),
                          std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z())};
    left.push_back(p.left_px);
    right.push_back(p.right_px);
  }
  const Image<Eigen::Vector3d>& undeformed = out.undeformed.point_mm;
  out.thickness_mm = ThicknessOver(carcass, undeformed, reference_.axis);
  for (int k = 0; k < carcass.mode_count(); ++k) {
    out.thickness_along_modes.push_back(
        ThicknessOver(carcass.AlongMode(k), undeformed, reference_.axis));
  }
  AddModes(f, left, right, &out);
  AddPoseErrors(frame, left, right, &out);
  return out;
}

void PointsOfFrames::AddPoseErrors(const RollingFrame& frame,
                                   const std::vector<Eigen::Vector2d>& left,
                                   const std::vector<Eigen::Vector2d>& right,
                                   FramePoints* out) const {
  StereoRig rig = reference_.rig;
  for (const Rigid3& pose : frame.right_from_left_moved) {
    rig.right_from_left = pose;
    const std::vector<Eigen::Vector3d> points = TriangulatePoints(rig, left, right);
    Image<Eigen::Vector3f> moved(rolling_.grid, Eigen::Vector3f::Zero());
    for (std::size_t i = 0; i < points.size(); ++i) {
      const RollingPoint& p = frame.points[i];
      moved(p.at.y(), p.at.x()) = (points[i] - p.point_mm).cast<float>();
    }
    out->along_pose_mm.push_back(std::move(moved));
  }
}

// Along a mode the points of the frame and of its view are both elsewhere, and so are the axis and
// the angles of both.
void PointsOfFrames::AddModes(std::size_t f, const std::vector<Eigen::Vector2d>& left,
                              const std::vector<Eigen::Vector2d>& right, FramePoints* out) const {
  const RollingFrame& frame = rolling_.frames[f];
  const WheelReferenceView& view = reference_.views[frame.view];
  const std::size_t K = axes_.size(), n = frame.points.size();
  if (K == 0) return;
  const Rigid3 rig_from_view = reference_.axis.RigFromWheel(view.angle_rad);
  std::vector<Eigen::Vector2d> view_left, view_right;
  for (const RollingPoint& p : frame.points) {
    const Eigen::Vector3d there = rig_from_view * p.undeformed_mm;
    view_left.push_back(reference_.rig.left.Project(there));
    view_right.push_back(reference_.rig.right.Project(reference_.rig.right_from_left * there));
  }
  std::vector<Eigen::Vector3f> moved(n * K), view_moved(n * K);
  modes_.Differences(left, right, moved);
  modes_.Differences(view_left, view_right, view_moved);
  if (reference_.delay_mode >= 0) {
    const auto mode = static_cast<std::size_t>(reference_.delay_mode);
    const double sigma_s = rolling_.right_delay.sigma_s;
    const double view_late_rad = reference_.SigmaLateTurnOf(view);
    std::vector<Eigen::Vector2d> right_px, view_right_px;
    for (const RollingPoint& p : frame.points) {
      const Eigen::Vector3d there = rig_from_view * p.undeformed_mm;
      right_px.push_back(sigma_s > 0 ? -sigma_s * RightVelocityOf(frame, p)
                                     : Eigen::Vector2d(Eigen::Vector2d::Zero()));
      view_right_px.push_back(-view_late_rad * RigidRightFlow(reference_, there));
    }
    FillModeOfMatches(reference_.rig, left, right, right_px, mode, moved);
    FillModeOfMatches(reference_.rig, view_left, view_right, view_right_px, mode, view_moved);
  }
  const ImageSize size = rolling_.grid;
  for (std::size_t k = 0; k < K; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    Image<Eigen::Vector3f> now(size, Eigen::Vector3f::Zero()), undeformed = now;
    const double then = view.angle_rad + reference_.angles_along_modes_rad(row, view.frame);
    const double angle =
        frame.angle_rad + rolling_.angle_along_modes_rad(row, static_cast<Eigen::Index>(f));
    const Rigid3 turn = axes_[k].RigFromWheel(angle) * axes_[k].RigFromWheel(then).Inverse();
    for (std::size_t i = 0; i < n; ++i) {
      const RollingPoint& p = frame.points[i];
      const int r = p.at.y(), c = p.at.x();
      now(r, c) = moved[i * K + k];
      const Eigen::Vector3d there =
          turn * (rig_from_view * p.undeformed_mm + view_moved[i * K + k].cast<double>());
      undeformed(r, c) = (there - out->undeformed.point_mm(r, c)).cast<float>();
    }
    out->now.along_modes_mm.push_back(std::move(now));
    out->undeformed.along_modes_mm.push_back(std::move(undeformed));
  }
}

}  // namespace plumbline::internal
