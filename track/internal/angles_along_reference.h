#pragma once

#include <Eigen/Core>

#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// What the random errors of a wheel's reference do to the angles of the frames that are measured
// against its views: of the axis and of the views' angles, which over an arc hang together. What a
// point says of the angle is
//   psi = material angle - angle of its place,
// both about the axis; so that an axis too near takes all turns since the view for too large. A
// column is the mean over a frame's points. One row an independent error, of one sigma.
[[nodiscard]] Eigen::MatrixXd AnglesAlongReference(const WheelReference& reference,
                                                   const RollingWheel& wheel);

}  // namespace plumbline::internal
