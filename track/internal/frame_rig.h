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
// not tell one: frames then keep that of the calibration.
[[nodiscard]] std::optional<RelativePose> PoseOfView(const StereoRig& rig,
                                                     const StereoField& field);

// The rig as it was in a frame: with the pose of the right camera refined, and told in the frame,
// where it has moved since the view was taken (or always). Without a pose of the view, or where the
// frame's matches tell none, it is the calibrated one.
// observations: FarApart() of the frame.
[[nodiscard]] StereoRig RigOfFrame(const StereoRig& rig, const std::optional<RelativePose>& view,
                                   std::span<const StereoObservation> observations,
                                   PoseRefinement refinement, RollingFrame* frame);

// The points of a frame whose matches share no noise, as ObservedPlaces(); and these matches.
[[nodiscard]] std::vector<std::size_t> PlacesFarApart(
    const StereoField& field, const Image<Eigen::Vector3f>& unit_covariance);
[[nodiscard]] std::vector<StereoObservation> FarApart(
    const StereoField& field, const Image<Eigen::Vector3f>& unit_covariance);

}  // namespace plumbline::internal
