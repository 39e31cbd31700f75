#pragma once

#include <Eigen/Core>

#include "apps/surface_evaluation.h"
#include "fit/surface_points.h"
#include "io/series_frame.h"
#include "track/rolling_survey.h"
#include "track/surface_state.h"
#include "track/wheel_reference.h"

// The wheel of a frame of a rolling tyre, for what is measured of it.
namespace plumbline::internal {

// The rig frame, held by the wheel: along a mode it moves so that the axis stays.
MeasurementFrame FrameOfWheel(const WheelReference& wheel);

// How the undeformed wheel has turned since the view; `frame`: its place in `rolling`.
BodyMotion TurnSinceView(const WheelReference& wheel, const RollingWheel& rolling,
                         std::size_t frame);

// Which material the points of a frame are: where they are displaced from, in the wheel frame.
MaterialField MaterialOf(const Rigid3& rig_from_wheel, const SeriesFrame& frame);

// The same, told in the ground frame of the moment. wheel_frame: FrameOfWheel().
BodyMotion InGround(BodyMotion in_rig, const MeasurementFrame& ground,
                    const MeasurementFrame& wheel_frame);

// In the ground frame, or without one in the rig frame; `frame` is placed. The centre is the point
// of the axis in the middle of the tread, where the cross-section has its largest radius, where
// that is seen. Along a calibration mode ground and axis move together: its sigmas of axis and
// centre are those in the rig frame.
WheelRecord WheelRecordOf(const WheelReference& wheel, const RollingWheel& rolling,
                          std::size_t frame, const UncertainFrame* ground);

// What is not known of the ground frame, in the random sigmas of positions in it.
void AddGroundErrors(const UncertainFrame& ground, Surface* surface);

}  // namespace plumbline::internal
