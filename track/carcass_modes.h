#pragma once

#include "fit/carcass_thickness.h"
#include "track/wheel_reference.h"

namespace plumbline {

// The wheel with the modes of a carcass behind those of its calibration, so that all that follows
// counts both alike: they move no camera, no axis and no angle, only the carcass's thickness
// (CarcassThickness::AlongMode; FindRollingContact). The same wheel where the thickness has no
// sigma. Throws UsageError where it has one and the rig has no modes: the calibration part of the
// errors, which they belong to, is not known then.
[[nodiscard]] WheelReference WithCarcassModes(WheelReference wheel,
                                              const CarcassThickness& carcass);

}  // namespace plumbline
