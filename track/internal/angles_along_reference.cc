#include "track/internal/angles_along_reference.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "track/internal/covariance_root.h"

namespace plumbline::internal {
namespace {

constexpr Eigen::Index kAxis = 4;
using AxisColumn = Eigen::Matrix<double, kAxis, 1>;

// Places in WheelReference::frames of the views that frames are measured against, each once.
std::vector<Eigen::Index> ViewsUsed(const WheelReference& reference, const RollingWheel& wheel) {
  std::vector<Eigen::Index> used;
  for (const RollingFrame& frame : wheel.frames) {
    if (frame.status == RollingFrameStatus::kPlaced) {
      used.push_back(reference.views[frame.view].frame);
    }
  }
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  return used;
}

// A root of the joint covariance of the axis and these frames' angles.
Eigen::MatrixXd RootOf(const WheelReference& reference, const std::vector<Eigen::Index>& frames) {
  const auto n = static_cast<Eigen::Index>(frames.size());
  Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(kAxis + n, kAxis + n);
  joint.topLeftCorner<kAxis, kAxis>() = reference.cov_axis_random;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index frame = frames[static_cast<std::size_t>(i)];
    for (Eigen::Index j = 0; j < n; ++j) {
      joint(kAxis + i, kAxis + j) =
          reference.cov_angles_random_rad2(frame, frames[static_cast<std::size_t>(j)]);
    }
    if (reference.cov_axis_angles_random.size() == 0) continue;
    const AxisColumn with_axis = reference.cov_axis_angles_random.col(frame);
    joint.col(kAxis + i).head<kAxis>() = with_axis;
    joint.row(kAxis + i).head<kAxis>() = with_axis.transpose();
  }
  return CovarianceRoot(joint);
}

// How the angle that a frame's points tell changes with the axis.
AxisColumn AlongAxis(const WheelReference& reference, const RollingFrame& frame) {
  constexpr double kStep = 1e-4;  // rad, mm
  const double then = reference.views[frame.view].angle_rad;
  const Rigid3 rig_from_view = reference.axis.RigFromWheel(then);
  AxisColumn along = AxisColumn::Zero();
  for (Eigen::Index k = 0; k < kAxis; ++k) {
    const WheelAxis off = reference.axis.Off(kStep * AxisColumn::Unit(k));
    const Rigid3 wheel_from_rig = off.RigFromWheel(0).Inverse();
    const Rigid3 material_from_rig = off.RigFromWheel(then).Inverse();
    const Rigid3 here_from_rig = reference.axis.RigFromWheel(0).Inverse();
    for (const RollingPoint& p : frame.points) {
      const double material = MaterialAngle(material_from_rig * (rig_from_view * p.undeformed_mm)) -
                              MaterialAngle(p.undeformed_mm);
      const double place =
          MaterialAngle(wheel_from_rig * p.point_mm) - MaterialAngle(here_from_rig * p.point_mm);
      along[k] += std::remainder(material - place, 2 * std::numbers::pi);
    }
  }
  return along / (kStep * static_cast<double>(std::max<std::size_t>(1, frame.points.size())));
}

}  // namespace

Eigen::MatrixXd AnglesAlongReference(const WheelReference& reference, const RollingWheel& wheel) {
  const std::vector<Eigen::Index> views = ViewsUsed(reference, wheel);
  const auto frames = static_cast<Eigen::Index>(wheel.frames.size());
  if (reference.cov_angles_random_rad2.size() == 0) return Eigen::MatrixXd::Zero(0, frames);
  const Eigen::MatrixXd root = RootOf(reference, views);
  Eigen::MatrixXd along = Eigen::MatrixXd::Zero(root.cols(), frames);
  for (std::size_t f = 0; f < wheel.frames.size(); ++f) {
    const RollingFrame& frame = wheel.frames[f];
    if (frame.status != RollingFrameStatus::kPlaced) continue;
    const Eigen::Index view =
        std::lower_bound(views.begin(), views.end(), reference.views[frame.view].frame) -
        views.begin();
    along.col(static_cast<Eigen::Index>(f)) =
        root.topRows<kAxis>().transpose() * AlongAxis(reference, frame) +
        root.row(kAxis + view).transpose();
  }
  return along;
}

}  // namespace plumbline::internal
