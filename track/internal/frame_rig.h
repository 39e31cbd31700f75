#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "calib/stereo_rig.h"
#include "calib/triangulate.h"
#include "match/stereo_sequence.h"
#include "track/camera_motion.h"
#include "track/rolling_survey.h"

namespace plumbline::internal {

// The pose of the cameras when a reference image was taken, by its matches; nothing where they do
// not tell one: frames then keep that of the calibration. alike_points: of RelativePoseOptions.
[[nodiscard]] std::optional<RelativePose> PoseOfView(const StereoRig& rig, const StereoField& field,
                                                     double alike_points);

// The rig as it was in a frame: with the pose of the right camera refined, and told in the frame,
// where it has moved since the view was taken (or always). Without a pose of the view, or where the
// frame's matches tell none, it is the calibrated one. right_common_px: as MotionSince().
[[nodiscard]] StereoRig RigOfFrame(const StereoRig& rig, const std::optional<RelativePose>& view,
                                   std::span<const StereoObservation> observations,
                                   std::span<const Eigen::Vector2d> right_common_px,
                                   double alike_points, PoseRefinement refinement,
                                   RollingFrame* frame);

}  // namespace plumbline::internal
