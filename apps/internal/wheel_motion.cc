#include "apps/internal/wheel_motion.h"

#include <Eigen/Eigenvalues>
#include <cmath>

namespace plumbline::internal {
namespace {

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

// cov_centre: random, in the rig frame.
void TellInGround(const UncertainFrame& ground, const Eigen::Matrix3d& cov_centre,
                  WheelRecord* record) {
  const Eigen::Matrix3d& turn = ground.frame_from_rig.rotation;
  record->axis = turn * record->axis;
  record->centre_mm = ground.frame_from_rig * record->centre_mm;
  Eigen::Matrix<double, 3, 6> d_centre, d_axis;
  d_centre << -Skew(record->centre_mm), Eigen::Matrix3d::Identity();
  d_axis << -Skew(record->axis), Eigen::Matrix3d::Zero();
  record->cov_axis_random = turn * record->cov_axis_random * turn.transpose() +
                            d_axis * ground.cov_random * d_axis.transpose();
  record->cov_axis_calibration = turn * record->cov_axis_calibration * turn.transpose();
  const Eigen::Matrix3d cov =
      turn * cov_centre * turn.transpose() + d_centre * ground.cov_random * d_centre.transpose();
  record->sigma_random_centre_mm = cov.diagonal().cwiseSqrt();
  record->sigma_calibration_centre_mm =
      (turn.cwiseAbs2() * record->sigma_calibration_centre_mm.cwiseAbs2()).cwiseSqrt();
}

}  // namespace

MeasurementFrame FrameOfWheel(const WheelReference& wheel) {
  MeasurementFrame frame;
  const Rigid3 rig_from_wheel = wheel.axis.RigFromWheel(0);
  for (Eigen::Index k = 0; k < wheel.axis_along_modes.rows(); ++k) {
    const WheelAxis there = wheel.axis.Off(wheel.axis_along_modes.row(k).transpose());
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
  const double sigma = rolling.frames[frame].sigma_random_rad;  // the view's among it
  body.random.push_back(Turn(wheel.axis, view.angle_rad, now + sigma));
  const Eigen::Matrix4d roots = RootsOf(wheel.cov_axis_random);
  for (Eigen::Index k = 0; k < roots.cols(); ++k) {
    body.random.push_back(Turn(wheel.axis.Off(roots.col(k)), view.angle_rad, now));
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

BodyMotion InGround(BodyMotion body, const MeasurementFrame& ground,
                    const MeasurementFrame& wheel_frame) {
  // Told first in the frame that the wheel holds, which moves with the modes in the rig.
  MeasurementFrame told{ground.frame_from_rig, {}};
  MeasurementFrame& motion = body.now_from_reference;
  for (std::size_t k = 0; k < ground.along_modes.size(); ++k) {
    told.along_modes.push_back(ground.along_modes[k] * wheel_frame.along_modes[k].Inverse());
    motion.along_modes[k] = told.along_modes[k] * motion.along_modes[k];
  }
  motion.frame_from_rig = told.frame_from_rig * motion.frame_from_rig;
  for (Rigid3& moved : body.random) moved = told.frame_from_rig * moved;
  for (Rigid3& moved : body.common) moved = told.frame_from_rig * moved;
  body.told_in = std::move(told);
  return body;
}

void AddGroundErrors(const UncertainFrame& ground, Surface* surface) {
  const Eigen::Matrix<float, 6, 6> roots = ground.Root().cast<float>();
  for (std::size_t i = 0; i < surface->position_mm.pixel_count(); ++i) {
    const Eigen::Vector3f& p = surface->position_mm.data()[i];
    if (!p.allFinite()) continue;
    Eigen::Vector3f& sigma = surface->sigma_random_mm.data()[i];
    Eigen::Vector3f variance = sigma.cwiseAbs2();
    for (int k = 0; k < 6; ++k) {
      const Eigen::Vector3f turn = roots.col(k).head<3>(), shift = roots.col(k).tail<3>();
      variance += (turn.cross(p) + shift).cwiseAbs2();
    }
    sigma = variance.cwiseSqrt();
  }
}

WheelRecord WheelRecordOf(const WheelReference& wheel, const RollingWheel& rolling,
                          std::size_t frame, const UncertainFrame* ground) {
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
  if (ground != nullptr)
    TellInGround(*ground, d_centre * wheel.cov_axis_random * d_centre.transpose(), &record);
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
