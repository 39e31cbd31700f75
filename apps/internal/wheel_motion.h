#pragma once

#include <Eigen/Core>

#include "apps/surface_evaluation.h"
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

// In the rig frame; `frame` is placed. The centre is the point of the axis in the middle of the
// tread, where the cross-section has its largest radius, where that is seen.
WheelRecord WheelRecordOf(const WheelReference& wheel, const RollingWheel& rolling,
                          std::size_t frame);

}  // namespace plumbline::internal
