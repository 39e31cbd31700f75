#include "apps/internal/wheel_motion.h"

#include <Eigen/Eigenvalues>
#include <cmath>

namespace plumbline::internal {
namespace {

// A wheel whose axis is off by a rotation about its x, y, z (rad) and a distance (mm).
WheelAxis Off(const WheelAxis& axis, const Eigen::Vector4d& by) {
  return {axis.rotation * RotationFromVector(by.head<3>()), axis.distance_mm + by[3]};
}

Rigid3 Turn(const WheelAxis& axis, double from_rad, double to_rad) {
  return axis.RigFromWheel(to_rad) * axis.RigFromWheel(from_rad).Inverse();
}

// Changes of one sigma each that together make up a covariance.
Eigen::Matrix4d RootsOf(const Eigen::Matrix4d& cov) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(cov);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

double AngleOf(const RollingWheel& rolling, std::size_t frame) {
  return rolling.frames[frame].angle_rad;
}

const WheelReferenceView& ViewOf(const WheelReference& wheel, const RollingWheel& rolling,
                                 std::size_t frame) {
  return wheel.views[rolling.frames[frame].view];
}

}  // namespace

MeasurementFrame FrameOfWheel(const WheelReference& wheel) {
  MeasurementFrame frame;
  const Rigid3 rig_from_wheel = wheel.axis.RigFromWheel(0);
  for (Eigen::Index k = 0; k < wheel.axis_along_modes.rows(); ++k) {
    const WheelAxis there = Off(wheel.axis, wheel.axis_along_modes.row(k).transpose());
    frame.along_modes.push_back(rig_from_wheel * there.RigFromWheel(0).Inverse());
  }
  return frame;
}

BodyMotion TurnSinceView(const WheelReference& wheel, const RollingWheel& rolling,
                         std::size_t frame) {
  const WheelReferenceView& view = ViewOf(wheel, rolling, frame);
  const double now = AngleOf(rolling, frame);
  BodyMotion body;
  body.now_from_reference.frame_from_rig = Turn(wheel.axis, view.angle_rad, now);
  for (Eigen::Index k = 0; k < wheel.axis_along_modes.rows(); ++k) {
    body.now_from_reference.along_modes.push_back(
        Turn(wheel.axis, view.angle_rad + wheel.angles_along_modes_rad(k, view.frame),
             now + rolling.angle_along_modes_rad(k, static_cast<Eigen::Index>(frame))));
  }
  const double sigma =
      std::hypot(rolling.frames[frame].sigma_random_rad,
                 wheel.frames[static_cast<std::size_t>(view.frame)].sigma_random_rad);
  body.random.push_back(Turn(wheel.axis, view.angle_rad, now + sigma));
  const Eigen::Matrix4d roots = RootsOf(wheel.cov_axis_random);
  for (Eigen::Index k = 0; k < roots.cols(); ++k) {
    body.random.push_back(Turn(Off(wheel.axis, roots.col(k)), view.angle_rad, now));
  }
  body.common.push_back(Turn(wheel.axis, view.angle_rad, now + rolling.sigma_common_rad));
  return body;
}

MaterialField MaterialOf(const Rigid3& rig_from_wheel, const SeriesFrame& frame) {
  const Rigid3 wheel_from_rig = rig_from_wheel.Inverse();
  MaterialField material{frame.displacement.value_mm};
  for (std::size_t i = 0; i < material.position_mm.pixel_count(); ++i) {
    Eigen::Vector3f& place = material.position_mm.data()[i];
    if (!place.allFinite()) continue;
    const Eigen::Vector3d undeformed =
        frame.surface.position_mm.data()[i].cast<double>() - place.cast<double>();
    place = (wheel_from_rig * undeformed).cast<float>();
  }
  return material;
}

WheelRecord WheelRecordOf(const WheelReference& wheel, const RollingWheel& rolling,
                          std::size_t frame) {
  const RollingFrame& now = rolling.frames[frame];
  const WheelProfile& profile = wheel.profile;
  WheelRecord record;
  record.found = true;
  record.axis = wheel.axis.direction_in_rig();
  const double middle_mm = std::isfinite(profile.crown_y_mm) ? profile.crown_y_mm : 0;
  record.centre_mm = wheel.axis.origin_in_rig_mm() + middle_mm * record.axis;
  record.radius_mm = profile.crown_radius_mm;
  record.angle_rad = now.angle_rad;
  record.speed_rad_s = now.speed_rad_s;
  // d axis = R (r x e_y), d origin = distance R (r x e_z) + R e_z d distance, r the rotation.
  Eigen::Matrix<double, 3, 4> d_axis = Eigen::Matrix<double, 3, 4>::Zero(), d_centre = d_axis;
  const Eigen::Matrix3d& R = wheel.axis.rotation;
  d_axis.leftCols<3>() = -R * Skew(Eigen::Vector3d::UnitY());
  d_centre.leftCols<3>() = -wheel.axis.distance_mm * R * Skew(Eigen::Vector3d::UnitZ());
  d_centre.col(3) = R.col(2);
  d_centre += middle_mm * d_axis;
  record.cov_axis_random = d_axis * wheel.cov_axis_random * d_axis.transpose();
  record.cov_axis_calibration = d_axis * wheel.cov_axis_calibration * d_axis.transpose();
  const auto sigma = [&](const Eigen::Matrix4d& cov) -> Eigen::Vector3d {
    return (d_centre * cov * d_centre.transpose()).diagonal().cwiseSqrt();
  };
  record.sigma_random_centre_mm = sigma(wheel.cov_axis_random);
  record.sigma_calibration_centre_mm = sigma(wheel.cov_axis_calibration);
  record.sigma_random_radius_mm = profile.sigma_crown_random_mm;
  record.sigma_calibration_radius_mm = profile.sigma_crown_calibration_mm;
  record.sigma_random_angle_rad = now.sigma_random_rad;
  record.sigma_calibration_angle_rad =
      std::hypot(now.sigma_calibration_rad, rolling.sigma_common_rad);
  record.sigma_random_speed_rad_s = now.sigma_random_rad_s;
  record.sigma_calibration_speed_rad_s = now.sigma_calibration_rad_s;
  return record;
}

}  // namespace plumbline::internal
