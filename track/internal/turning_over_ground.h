#pragma once

#include <cstddef>

#include "fit/surface_points.h"
#include "track/rig_rotation.h"
#include "track/rolling_survey.h"

namespace plumbline::internal {

// The speed at which a wheel turns over the ground in frame f, as a mean from frame `first` to
// `last` (f and its neighbours, or f and one of them: then it is that of half-way): the one that
// the rig sees, less that at which the ground turns in the rig. Its sigma is that of the former:
// random errors of the ground are in what is measured with it too (WheelTurning).
[[nodiscard]] MeasuredScalar TurningOverGround(const RollingWheel& wheel, std::size_t first,
                                               std::size_t f, std::size_t last,
                                               const RigRotationFrame& from,
                                               const RigRotationFrame& to);

// The speed of the wheel in frame f over its mean from first to last, as the rig sees it.
struct SpeedRatio {
  double value = 1, sigma = 0;  // random
};
[[nodiscard]] SpeedRatio SpeedSince(const RollingWheel& wheel, std::size_t first, std::size_t f,
                                    std::size_t last);

}  // namespace plumbline::internal
