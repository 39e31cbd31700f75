#pragma once

#include "calib/image.h"
#include "io/series_frame.h"
#include "track/rolling_contact.h"

// What a series holds of a frame of a rolling tyre, out of what was found; in the frame's ground
// frame.
namespace plumbline::internal {

// With the ground as the smoothed rotation has it.
GroundRecord GroundRecordOf(const RigRotationFrame& rotation);
RigRotationRecord RigRotationRecordOf(const RigRotationFrame& rotation);
PatchRecord PatchRecordOf(const RollingContactFrame& frame, double threshold_mm);
DeformationRecord DeformationRecordOf(const WheelDeformation& deformation);
// The points' velocities are put on every `stride`-th row and column of `grid`.
SlipRecord SlipRecordOf(const RollingContactFrame& frame, ImageSize grid, int stride);

}  // namespace plumbline::internal
