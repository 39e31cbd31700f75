#include "fit/wheel_axis.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "calib/error.h"

namespace plumbline {

Rigid3 WheelAxis::RigFromWheel(double angle_rad) const {
  return {rotation * TurnAboutY(angle_rad), origin_in_rig_mm()};
}

WheelAxis WheelAxis::Off(const Eigen::Vector4d& by) const {
  return {rotation * RotationFromVector(by.head<3>()), distance_mm + by[3]};
}

WheelAxis WheelAxis::Through(const Eigen::Vector3d& point_in_rig_mm,
                             const Eigen::Vector3d& direction_in_rig) {
  constexpr double kNearest_mm = 0.1;
  const Eigen::Vector3d y = direction_in_rig.normalized();
  const Eigen::Vector3d foot = point_in_rig_mm - y * y.dot(point_in_rig_mm);
  WheelAxis axis;
  axis.distance_mm = foot.norm();
  if (!y.allFinite() || !(axis.distance_mm > kNearest_mm)) {
    throw InputError(
        "the wheel axis goes through the left camera, so that nothing tells where the wheel's "
        "zero is; mount the rig away from the axis");
  }
  const Eigen::Vector3d z = foot / axis.distance_mm;
  axis.rotation << y.cross(z), y, z;
  return axis;
}

Eigen::Matrix3d TurnAboutY(double angle_rad, Eigen::Matrix3d* dR) {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  Eigen::Matrix3d R;
  R << c, 0, s, 0, 1, 0, -s, 0, c;
  if (dR != nullptr) *dR << -s, 0, c, 0, 0, 0, -c, 0, -s;
  return R;
}

WheelAxis AxisOfTurns(std::span<const Rigid3> turns) {
  constexpr double kLeastTurn_rad = 0.01;
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero(), normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero(), rhs = Eigen::Vector3d::Zero();
  for (const Rigid3& turn : turns) {
    const Eigen::Vector3d w = turn.RotationVector();
    const Eigen::Matrix3d away = Eigen::Matrix3d::Identity() - turn.rotation;
    spread += w * w.transpose();
    sum += w;
    normal += away.transpose() * away;
    rhs += away.transpose() * turn.translation_mm;
  }
  if (!(std::sqrt(spread.trace()) > kLeastTurn_rad)) {
    throw InputError("the wheel does not turn enough to say where its axis is");
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(spread);
  Eigen::Vector3d direction = eigen.eigenvectors().col(2);
  if (direction.dot(sum) < 0) direction = -direction;
  // Nothing is known along the axis: hold the point there.
  normal += normal.trace() * direction * direction.transpose();
  return WheelAxis::Through(normal.ldlt().solve(rhs), direction);
}

double AngleAbout(const WheelAxis& axis, const Rigid3& turn) {
  // Twist of the swing-twist decomposition.
  const Eigen::Quaterniond q(turn.rotation);
  const double angle = 2 * std::atan2(q.vec().dot(axis.direction_in_rig()), q.w());
  return std::remainder(angle, 2 * std::numbers::pi);
}

}  // namespace plumbline
