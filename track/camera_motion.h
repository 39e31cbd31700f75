#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/relative_pose.h"
#include "calib/stereo_rig.h"
#include "calib/triangulate.h"

namespace plumbline {

// Whether the right camera has moved against the left one between two pairs of images, and the pose
// of the later one: what calibration and lenses get wrong is in both and cancels.

// When the pose of the right camera is refined from the matches of each frame.
enum class PoseRefinement : std::uint8_t {
  kOff = 0,  // never; an alarm is given all the same
  // Where the camera has moved beyond doubt: in those frames, or, where all are known beforehand
  // (RollingSurvey), in all as soon as it has in one.
  kWhenSignificant,
  kAlways,
};

struct CameraMotionLimits {
  // The camera has moved where the chi-squared (5 degrees of freedom) of its motion, by what the
  // matches scatter where that is more than they claim, is above this, and where it takes the
  // points from their epipolar lines by more than so much (rms): what lenses get wrong is no
  // motion.
  double chi2 = 40;
  double epipolar_px = 0.015;

  bool Beyond(double motion_chi2, double with_px, double without_px) const;
};

struct CameraMotion {
  RelativePose pose;  // of the later pair
  PoseChange since;   // the earlier one
  bool moved = false;
};

// The pose of a pair by its matches, whose scatter counts. alike_points: of them, that share one
// noise (RelativePoseOptions). Throws InputError as RefineRelativePose().
[[nodiscard]] RelativePose PoseOfPair(const StereoRig& rig,
                                      std::span<const StereoObservation> observations,
                                      double alike_points = 1);

// observations: of the later pair. right_common_px: what one sigma of a random error that all of
// them have in common adds to each right pixel; empty: nothing. Throws InputError as
// RefineRelativePose(), std::invalid_argument where numbers differ.
[[nodiscard]] CameraMotion MotionSince(const StereoRig& rig, const RelativePose& earlier,
                                       std::span<const StereoObservation> observations,
                                       double alike_points = 1,
                                       const CameraMotionLimits& limits = {},
                                       std::span<const Eigen::Vector2d> right_common_px = {});

// right_from_left after a motion of the right camera in its own frame (rotation vector rad,
// translation mm).
[[nodiscard]] Rigid3 PoseAfter(const Eigen::Matrix<double, 6, 1>& motion, const Rigid3& pose);

// One standard deviation of a motion along each of its five independent directions, rotations
// counting by what they do to the baseline; the largest first. Along the baseline there is none.
[[nodiscard]] std::vector<Eigen::Matrix<double, 6, 1>> ErrorsOfMotion(
    const Eigen::Matrix<double, 6, 6>& cov, double baseline_mm);

// The pose with the length of the rig's own baseline, which matches cannot tell.
[[nodiscard]] Rigid3 WithBaselineOf(const StereoRig& rig, Rigid3 pose);

}  // namespace plumbline
