#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "track/rig_rotation.h"

namespace plumbline::internal {

// The state of the pose, as in PoseErrors.
inline constexpr int kPoseState = PoseErrors::kState;
using PoseState = Eigen::Matrix<double, kPoseState, 1>;
using PoseStateCov = PoseErrors::Matrix;
// Pitch, roll and height out of it.
inline constexpr int kPlaceOf[3] = {0, 2, 3};
Eigen::Matrix3d PoseOf(const PoseStateCov& cov);
// The same as if the errors that all frames have in common were known.
Eigen::Matrix3d PoseWithoutCommon(const PoseStateCov& cov);

// How many of pitch, roll and height, in this order, a frame tells by itself; the height above a
// top comes on top.
int AnglesAndHeight(const PoseObservation& frame);

struct PoseModel {
  bool with_rate = false;
  RigPose noise = RigPose::Zero();  // as in RigRotation
  double unseen_height_mm = 0;      // a sqrt(s), on top where there is no plane
  RigPose prior = RigPose::Zero(), prior_sigma = RigPose::Zero();  // finite
  double obstacle_mm = 0, sigma_obstacle_mm = 0;  // of a top that was not stood on before
};

// Which frames' observations are taken, and how likely they are together.
struct PoseLikelihood {
  double log_likelihood = 0;
  std::vector<std::uint8_t> taken;
};

// Through the frames in their order, or from the last to the first. An observation that is likelier
// to be bad (1 % of all, anywhere) is not taken.
PoseLikelihood LikelihoodOf(std::span<const PoseObservation> frames, const PoseModel& model,
                            bool backwards);

struct SmoothedPose {
  RigPose pose = RigPose::Zero();
  PoseState state = PoseState::Zero();            // that `pose` is of
  Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();  // random
  PoseErrors errors;
  std::vector<RigPose> along_modes;
};

// With the observations that are taken. All have as many modes as the first one has.
std::vector<SmoothedPose> SmoothPoses(std::span<const PoseObservation> frames,
                                      const std::vector<std::uint8_t>& taken,
                                      const PoseModel& model);

// How far an observation lies from what all others say, squared, in their common sigmas. taken:
// whether it is in the smoothed pose.
double Contradiction(const PoseObservation& frame, const SmoothedPose& smoothed, bool taken);

}  // namespace plumbline::internal
