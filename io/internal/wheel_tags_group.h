#pragma once

#include <hdf5.h>

#include "track/wheel_reference.h"

namespace plumbline::internal {

// /wheel/tags of a wheel file: the tags on the wheel, see docs/file_format.md. Written only where
// tags were looked for; a file without the group is of a wheel whose tags nobody looked for.
void WriteWheelTags(hid_t file, const WheelTags& tags, int modes);

// Bit for bit as they were written. Throws hdf5::Error where something is wrong in the group.
WheelTags ReadWheelTags(hid_t file, int modes);

}  // namespace plumbline::internal
