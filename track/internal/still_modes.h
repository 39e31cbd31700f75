#pragma once

#include "track/wheel_reference.h"

namespace plumbline::internal {

// Modes behind those of the calibration that move no camera, no axis and no angle, so that what
// they stand for counts with the calibration. `what` has them: a noun for the message. Throws
// UsageError where the rig has no modes: the calibration part of the errors is not known then.
void AppendStillModes(int count, const char* what, WheelReference* wheel);

}  // namespace plumbline::internal
