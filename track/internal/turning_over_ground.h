#pragma once

#include <cstddef>
#include <span>

#include "fit/surface_points.h"
#include "track/rig_rotation.h"
#include "track/rolling_survey.h"

namespace plumbline::internal {

// The speed at which a wheel turns over the ground in frame f, by the poses of frame `first` and
// the one or two after it, of which f is one: the one that the rig sees, less that at which the
// ground turns in the rig. Of three frames both are slopes of parabolas, as the velocity of the
// material is: what a parabola does not follow is left out of both, and of the radius that is their
// ratio. Of two it is that of half-way. weights: SlopeWeights() of the frames. Its sigma is that of
// the former (the slope's, not the smoothed speed's): random errors of the ground are in what is
// measured with it too (WheelTurning).
[[nodiscard]] MeasuredScalar TurningOverGround(const RollingWheel& wheel, std::size_t first,
                                               std::size_t f,
                                               std::span<const RigRotationFrame> poses,
                                               std::span<const double> weights);

// The speed of the wheel over the ground in frame f over its mean from frame `first` to `last`, f
// being one of them: it changes as the speed that the rig sees, less the rate at which the ground
// turns in the rig: the slope at f of the parabola through the poses.
// poses: of f, its neighbour and the frame behind that, in order of time; or without the last one.
struct SpeedRatio {
  double value = 1, sigma = 0;  // random
};
[[nodiscard]] SpeedRatio SpeedAtEnd(const RollingWheel& wheel, std::size_t first, std::size_t f,
                                    std::size_t last, std::span<const RigRotationFrame> poses);

}  // namespace plumbline::internal
