#include "track/internal/turning_over_ground.h"

#include <cmath>

namespace plumbline::internal {
namespace {

double MeanSpeed(const RollingWheel& wheel, std::size_t first, std::size_t f, std::size_t last) {
  if (first < f && f < last) return wheel.frames[f].speed_rad_s;
  return (wheel.frames[first].speed_rad_s + wheel.frames[last].speed_rad_s) / 2;
}

double RateOf(const RigRotationFrame& a, const RigRotationFrame& b) {
  return (b.pose[0] - a.pose[0]) / (b.time_s - a.time_s);
}

// How much faster the ground turns in the rig at an end of the frames than between that and the
// next one.
struct RateChange {
  double value = 0, sigma = 0;  // rad/s
};
RateChange RateAtEnd(std::span<const RigRotationFrame> poses, bool begins) {
  for (const RigRotationFrame& frame : poses) {
    if (!frame.known[0]) return {};
  }
  if (poses.size() < 3) return {};
  // The second divided difference: the sum over the three of pose / product of the times to others.
  const RigRotationFrame &a = poses[0], &b = poses[1], &c = poses[2];
  const double way_s = begins ? a.time_s - b.time_s : c.time_s - b.time_s;
  const double ab_s = b.time_s - a.time_s, bc_s = c.time_s - b.time_s, ac_s = c.time_s - a.time_s;
  const Eigen::MatrixXd root = RandomRoot(poses);
  const Eigen::RowVectorXd error =
      root.row(0) / (ab_s * ac_s) - root.row(3) / (ab_s * bc_s) + root.row(6) / (ac_s * bc_s);
  return {way_s * (RateOf(b, c) - RateOf(a, b)) / ac_s, std::abs(way_s) * error.norm()};
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

SpeedRatio SpeedAtEnd(const RollingWheel& wheel, std::size_t first, std::size_t f, std::size_t last,
                      std::span<const RigRotationFrame> poses) {
  const bool begins = f == first;
  const std::size_t from = begins ? 0 : poses.size() - 2;
  const double in_the_rig = MeanSpeed(wheel, first, f, last);
  const double mean = in_the_rig - RateOf(poses[from], poses[from + 1]);
  const RateChange ground = RateAtEnd(poses, begins);
  const double half_difference =
      std::hypot(wheel.frames[first].sigma_random_rad_s, wheel.frames[last].sigma_random_rad_s) / 2;
  return {1 + (wheel.frames[f].speed_rad_s - in_the_rig - ground.value) / mean,
          std::hypot(half_difference, ground.sigma) / std::abs(mean)};
}

}  // namespace plumbline::internal
