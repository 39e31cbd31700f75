#include "track/internal/frame_rig.h"

#include <algorithm>

#include "calib/error.h"
#include "track/surface_state.h"

namespace plumbline::internal {
namespace {

// Points so far apart share no noise.
int StrideOf(const StereoField& field) {
  const int subset_px = field.left.subset_px, step_px = field.left.step_px;
  return std::max(1, (subset_px + step_px - 1) / step_px);
}

}  // namespace

std::vector<std::size_t> PlacesFarApart(const StereoField& field,
                                        const Image<Eigen::Vector3f>& unit_covariance) {
  return ObservedPlaces(field, unit_covariance, StrideOf(field));
}

std::vector<StereoObservation> FarApart(const StereoField& field,
                                        const Image<Eigen::Vector3f>& unit_covariance) {
  return ObservationsOf(field, unit_covariance, StrideOf(field));
}

std::optional<RelativePose> PoseOfView(const StereoRig& rig, const StereoField& field) {
  try {
    return PoseOfPair(rig, FarApart(field, UnitCovariance(field, field)));
  } catch (const InputError&) {
    return std::nullopt;
  }
}

StereoRig RigOfFrame(const StereoRig& rig, const std::optional<RelativePose>& view,
                     std::span<const StereoObservation> observations, PoseRefinement refinement,
                     RollingFrame* frame) {
  frame->right_from_left.reset();
  frame->right_from_left_moved.clear();
  if (!view) return rig;
  StereoRig now = rig;
  try {
    const CameraMotion motion = MotionSince(rig, *view, observations);
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
