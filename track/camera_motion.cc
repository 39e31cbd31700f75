#include "track/camera_motion.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace plumbline {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

}  // namespace

bool CameraMotionLimits::Beyond(double motion_chi2, double with_px, double without_px) const {
  const double taken_px = std::sqrt(std::max(0.0, with_px * with_px - without_px * without_px));
  return motion_chi2 > chi2 && taken_px > epipolar_px;
}

RelativePose PoseOfPair(const StereoRig& rig, std::span<const StereoObservation> observations,
                        double alike_points) {
  RelativePoseOptions options;
  options.alike_points = alike_points;
  options.scale_by_scatter = true;
  return RefineRelativePose(rig, observations, options);
}

CameraMotion MotionSince(const StereoRig& rig, const RelativePose& earlier,
                         std::span<const StereoObservation> observations, double alike_points,
                         const CameraMotionLimits& limits,
                         std::span<const Eigen::Vector2d> right_common_px) {
  if (!right_common_px.empty() && right_common_px.size() != observations.size()) {
    throw std::invalid_argument("MotionSince: not an error for each observation");
  }
  RelativePoseOptions options;
  options.alike_points = alike_points;
  options.scale_by_scatter = true;
  options.other_pose = earlier.right_from_left;
  CameraMotion motion;
  motion.pose = RefineRelativePose(rig, observations, options);
  if (!right_common_px.empty()) {
    std::vector<StereoObservation> moved(observations.begin(), observations.end());
    for (std::size_t i = 0; i < moved.size(); ++i) moved[i].right += right_common_px[i];
    const Vector6 error = Between(motion.pose, RefineRelativePose(rig, moved, options)).change;
    motion.pose.cov_random += error * error.transpose();
  }
  motion.since = Between(earlier, motion.pose);
  motion.moved = limits.Beyond(motion.since.chi2, motion.pose.epipolar_rms_other_px,
                               motion.pose.epipolar_rms_after_px);
  return motion;
}

Rigid3 PoseAfter(const Vector6& motion, const Rigid3& pose) {
  return Rigid3::FromRotationVector(motion.head<3>(), motion.tail<3>()) * pose;
}

std::vector<Vector6> ErrorsOfMotion(const Matrix6& cov, double baseline_mm) {
  Vector6 unit;
  unit << Eigen::Vector3d::Constant(baseline_mm), Eigen::Vector3d::Ones();
  const Eigen::SelfAdjointEigenSolver<Matrix6> parts(unit.asDiagonal() * cov * unit.asDiagonal());
  std::vector<Vector6> errors;
  for (int place = 5; place > 0; --place) {  // the last is the baseline's length
    errors.emplace_back(std::sqrt(std::max(0.0, parts.eigenvalues()[place])) *
                        parts.eigenvectors().col(place).cwiseQuotient(unit));
  }
  return errors;
}

Rigid3 WithBaselineOf(const StereoRig& rig, Rigid3 pose) {
  pose.translation_mm *= rig.baseline_mm() / pose.translation_mm.norm();
  return pose;
}

}  // namespace plumbline
