#include "track/internal/turning_over_ground.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace plumbline::internal {
namespace {

double MeanSpeed(const RollingWheel& wheel, std::size_t first, std::size_t last) {
  return (wheel.frames[first].speed_rad_s + wheel.frames[last].speed_rad_s) / 2;
}

// Of the slope of the parabola through three angles: by what each frame says of its own, by what
// they have in common, and by how far places disagree on the turns beside f. Of two, and where a
// channel tells the turns, that of the smoothed speed.
double SigmaOfSlope(const RollingWheel& wheel, std::size_t first, std::size_t f,
                    std::span<const double> weights) {
  const RollingFrame& frame = wheel.frames[f];
  if (weights.size() < 3 || std::isfinite(frame.channel_lean)) return frame.sigma_random_rad_s;
  double variance = 0;
  Eigen::VectorXd common = Eigen::VectorXd::Zero(wheel.angle_along_reference_rad.rows());
  double spread = 0;
  for (std::size_t k = 0; k < weights.size(); ++k) {
    const RollingFrame& told = wheel.frames[first + k];
    variance += std::pow(weights[k] * told.sigma_measured_rad, 2);
    common +=
        weights[k] * wheel.angle_along_reference_rad.col(static_cast<Eigen::Index>(first + k));
    if (k == 0) continue;
    const double interval_s = told.time_s - wheel.frames[first + k - 1].time_s;
    spread = std::max(spread, wheel.deformation.frames[first + k].turn_spread_rad / interval_s);
  }
  return std::sqrt(variance + common.squaredNorm() + spread * spread);
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

std::vector<double> SlopeWeights(std::span<const double> times, std::size_t at) {
  if (times.size() == 2) {
    const double per_s = 1 / (times[1] - times[0]);
    return {-per_s, per_s};
  }
  std::vector<double> weights(3);
  for (std::size_t k = 0; k < 3; ++k) {
    const double t = times[k], u = times[(k + 1) % 3], v = times[(k + 2) % 3];
    weights[k] = (2 * times[at] - u - v) / ((t - u) * (t - v));
  }
  return weights;
}

MeasuredScalar TurningOverGround(const RollingWheel& wheel, std::size_t first, std::size_t f,
                                 std::span<const RigRotationFrame> poses,
                                 std::span<const double> weights) {
  MeasuredScalar speed;
  speed.value = poses.size() == 2 ? MeanSpeed(wheel, first, first + 1) : 0;
  speed.sigma_random = SigmaOfSlope(wheel, first, f, weights);
  speed.along_modes = wheel.speed_along_modes_rad_s.col(static_cast<Eigen::Index>(f));
  for (std::size_t k = 0; k < poses.size(); ++k) {
    if (poses.size() > 2) speed.value += weights[k] * wheel.frames[first + k].angle_rad;
    speed.value -= weights[k] * poses[k].pose[0];
    for (Eigen::Index mode = 0; mode < speed.along_modes.size(); ++mode) {
      const auto at = static_cast<std::size_t>(mode);
      if (at >= poses[k].along_modes.size()) break;  // the pose was given by hand
      speed.along_modes[mode] -= weights[k] * poses[k].along_modes[at][0];
    }
  }
  return speed;
}

SpeedRatio SpeedAtEnd(const RollingWheel& wheel, std::size_t first, std::size_t f, std::size_t last,
                      std::span<const RigRotationFrame> poses) {
  const bool begins = f == first;
  const std::size_t from = begins ? 0 : poses.size() - 2;
  const double in_the_rig = MeanSpeed(wheel, first, last);
  const double mean = in_the_rig - RateOf(poses[from], poses[from + 1]);
  const RateChange ground = RateAtEnd(poses, begins);
  const double half_difference =
      std::hypot(wheel.frames[first].sigma_random_rad_s, wheel.frames[last].sigma_random_rad_s) / 2;
  return {1 + (wheel.frames[f].speed_rad_s - in_the_rig - ground.value) / mean,
          std::hypot(half_difference, ground.sigma) / std::abs(mean)};
}

}  // namespace plumbline::internal
