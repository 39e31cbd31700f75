#pragma once

#include <Eigen/Core>

#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// What a survey makes of a wheel's tags.

// The tags that a frame shows and what they say, where the wheel has any. False, and the frame's
// problem set, where they contradict each other.
bool LookForTags(const WheelReference& wheel, const GrayImage& left, const GrayImage& right,
                 RollingFrame& frame);

// Where tags on the rim tell the wheel's angle, the measured angles of all frames become the rim's
// (HoldToRim). Gives back what the calibration modes do to the measured angles.
Eigen::MatrixXd HoldToTags(const WheelReference& wheel, RollingWheel& rolling);

}  // namespace plumbline::internal
