#pragma once

#include "fit/ground_plane.h"
#include "io/series_frame.h"

namespace plumbline::internal {

// A plane as a series holds it, without what the calibration adds.
GroundRecord GroundRecordOf(const GroundPlane& plane, const Rigid3& ground_from_rig);

}  // namespace plumbline::internal
