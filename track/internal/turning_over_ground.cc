#include "track/internal/turning_over_ground.h"

#include <cmath>

namespace plumbline::internal {
namespace {

double MeanSpeed(const RollingWheel& wheel, std::size_t first, std::size_t f, std::size_t last) {
  if (first < f && f < last) return wheel.frames[f].speed_rad_s;
  return (wheel.frames[first].speed_rad_s + wheel.frames[last].speed_rad_s) / 2;
}

}  // namespace

MeasuredScalar TurningOverGround(const RollingWheel& wheel, std::size_t first, std::size_t f,
                                 std::size_t last, const RigRotationFrame& from,
                                 const RigRotationFrame& to) {
  const double time_s = to.time_s - from.time_s;
  MeasuredScalar speed;
  speed.value = MeanSpeed(wheel, first, f, last) - (to.pose[0] - from.pose[0]) / time_s;
  speed.sigma_random = wheel.frames[f].sigma_random_rad_s;
  speed.along_modes = wheel.speed_along_modes_rad_s.col(static_cast<Eigen::Index>(f));
  for (Eigen::Index k = 0; k < speed.along_modes.size(); ++k) {
    const auto mode = static_cast<std::size_t>(k);
    if (mode >= from.along_modes.size()) break;  // the pose was given by hand
    speed.along_modes[k] -= (to.along_modes[mode][0] - from.along_modes[mode][0]) / time_s;
  }
  return speed;
}

SpeedRatio SpeedSince(const RollingWheel& wheel, std::size_t first, std::size_t f,
                      std::size_t last) {
  if (first < f && f < last) return {};
  const double mean = MeanSpeed(wheel, first, f, last);
  const double half_difference =
      std::hypot(wheel.frames[first].sigma_random_rad_s, wheel.frames[last].sigma_random_rad_s) / 2;
  return {wheel.frames[f].speed_rad_s / mean, half_difference / mean};
}

}  // namespace plumbline::internal
