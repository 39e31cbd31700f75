#include "track/internal/frame_rig.h"

#include "calib/error.h"
#include "track/surface_state.h"

namespace plumbline::internal {

std::optional<RelativePose> PoseOfView(const StereoRig& rig, const StereoField& field,
                                       double alike_points) {
  try {
    return PoseOfPair(rig, ObservationsOf(field, UnitCovariance(field, field)), alike_points);
  } catch (const InputError&) {
    return std::nullopt;
  }
}

StereoRig RigOfFrame(const StereoRig& rig, const std::optional<RelativePose>& view,
                     std::span<const StereoObservation> observations,
                     std::span<const Eigen::Vector2d> right_common_px, double alike_points,
                     PoseRefinement refinement, RollingFrame* frame) {
  frame->right_from_left.reset();
  frame->right_from_left_moved.clear();
  if (!view) return rig;
  StereoRig now = rig;
  try {
    const CameraMotion motion =
        MotionSince(rig, *view, observations, alike_points, {}, right_common_px);
    if (!motion.moved && refinement != PoseRefinement::kAlways) return rig;
    now.right_from_left = WithBaselineOf(rig, PoseAfter(motion.since.change, rig.right_from_left));
    for (const auto& error : ErrorsOfMotion(motion.since.cov_random, rig.baseline_mm())) {
      frame->right_from_left_moved.push_back(PoseAfter(error, now.right_from_left));
    }
    frame->right_from_left = now.right_from_left;
  } catch (const InputError&) {
    return rig;
  }
  return now;
}

}  // namespace plumbline::internal
