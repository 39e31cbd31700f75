#pragma once

#include <Eigen/Core>
#include <cstddef>

#include "calib/image.h"
#include "match/planar_field.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline {

// How fast the right pixels of a rolling wheel's material go beside RightFlow, which believes that
// the tyre keeps its shape under the rig. Above an obstacle, which goes with the ground, it does
// not: with r(x, t) the right pixel of what stands at place x of the undeformed wheel under the
// rig, and x the place that the material goes through,
//   d r / d t = speed * d r / d turn + drift,   drift = the change of r at x with time.
// It is told by the frames beside a frame: of r less that of the undeformed surface there, planes
// through the points around x in each (MaterialLookup), as the slope of a parabola through three
// frames: this one and one on either side, at an end both on one. Its error is one sixth of the
// third derivative with time by the product of both intervals; of two frames alone half of the
// second by the interval.

// Fills RollingFrame::right_drift_px_s and right_drift_left_out of the frames that are placed and
// have one beside them that is, with times. Where the points beside do not surround a point, it
// goes on as at the nearest one where they do.
void FindRightDrift(const WheelReference& wheel, RollingWheel* rolling);

// How fast the right pixel at a place of RollingWheel::grid (row * columns + column), of the flow
// that it has there, goes with its material (px/s); and that of a survey's point.
[[nodiscard]] Eigen::Vector2d RightVelocityAt(const RollingFrame& frame, std::size_t place,
                                              const Eigen::Vector2d& flow_px);
[[nodiscard]] Eigen::Vector2d RightVelocityOf(const RollingFrame& frame, const RollingPoint& point);

// The same of a grid of finer points: flow_px of them (RightFlow::Of), NaN where that is.
[[nodiscard]] Image<Eigen::Vector2d> RightVelocity(const RollingWheel& rolling, std::size_t frame,
                                                   const Image<Eigen::Vector2d>& flow_px,
                                                   const PlanarField& grid);

// What of the drift at a place of RollingWheel::grid may be left out (px/s, one sigma, alike all
// over the frame): so much of it as the ground goes on till the frames beside, in the mean, over
// 45 mm. That is by how much it is off over obstacles of the virtual rig
// (tests/track/right_drift_test.cc). Nothing where no drift is known.
[[nodiscard]] Eigen::Vector2d RightDriftLeftOutAt(const RollingFrame& frame, std::size_t place);

// What that does to the right pixels of a grid of finer points through RollingWheel::right_delay
// (px); empty where no drift is known.
[[nodiscard]] Image<Eigen::Vector2d> RightDriftLeftOut(const RollingWheel& rolling,
                                                       std::size_t frame, const PlanarField& grid);

}  // namespace plumbline
