#pragma once

#include <cstddef>

#include "fit/surface_points.h"
#include "track/rig_rotation.h"
#include "track/rolling_survey.h"

namespace plumbline::internal {

// How much the errors of a smoothed ground go together from frame to frame.
inline constexpr double kPosesAlike = 0.9;

// Of how far the ground has turned in the rig, about the wheel's axis, between two frames.
[[nodiscard]] double SigmaOfTurnedGround(const RigRotationFrame& from, const RigRotationFrame& to,
                                         double alike);

// The speed at which a wheel turns over the ground in frame f, as a mean from frame `first` to
// `last` (f and its neighbours, or f and one of them: then it is that of half-way): the one that
// the rig sees, less that at which the ground turns in the rig. alike: how much the errors of both
// poses go together.
[[nodiscard]] MeasuredScalar TurningOverGround(const RollingWheel& wheel, std::size_t first,
                                               std::size_t f, std::size_t last,
                                               const RigRotationFrame& from,
                                               const RigRotationFrame& to, double alike);

// The speed of the wheel in frame f over its mean from first to last, as the rig sees it.
struct SpeedRatio {
  double value = 1, sigma = 0;  // random
};
[[nodiscard]] SpeedRatio SpeedSince(const RollingWheel& wheel, std::size_t first, std::size_t f,
                                    std::size_t last);

}  // namespace plumbline::internal
