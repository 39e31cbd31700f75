#include "apps/internal/body_motion.h"

#include "calib/parallel.h"
#include "match/planar_field.h"

namespace plumbline::internal {

SurfaceState UndeformedNow(const SurfaceState& at_reference, const BodyMotion& body) {
  MeasurementFrame motion = body.now_from_reference;
  // What else the state is known along, such as refined poses, does not change it.
  motion.along_modes.resize(at_reference.along_modes_mm.size(), motion.frame_from_rig);
  return InFrame(at_reference, motion);
}

SurfaceMotion MotionFromBody(const SurfaceState& at_reference, const SurfaceState& undeformed_now,
                             const SurfaceState& now, const Image<Eigen::Vector3f>& cov_px2,
                             const BodyMotion& body) {
  SurfaceMotion motion = MotionBetween(undeformed_now, now, cov_px2);
  ForEachIndex(motion.value_mm.pixel_count(), [&](std::size_t i) {
    if (!motion.value_mm.data()[i].allFinite()) return;
    const Eigen::Vector3d& before = at_reference.point_mm.data()[i];
    const auto off = [&](const Rigid3& moved) {
      return (moved * before - undeformed_now.point_mm.data()[i]).eval();
    };
    Eigen::Matrix3d random = Eigen::Matrix3d::Zero();
    for (const Rigid3& moved : body.random) random += off(moved) * off(moved).transpose();
    motion.cov_random_mm2.data()[i] += TriangleOf(random);
    Eigen::Vector3f& calibration = motion.sigma_calibration_mm.data()[i];
    Eigen::Vector3d common = calibration.cast<double>().cwiseAbs2();
    for (const Rigid3& moved : body.common) common += off(moved).cwiseAbs2();
    calibration = common.cwiseSqrt().cast<float>();
  });
  return motion;
}

}  // namespace plumbline::internal
