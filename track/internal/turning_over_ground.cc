#include "track/internal/turning_over_ground.h"

#include <array>
#include <cmath>

#include "track/internal/finite_differences.h"

namespace plumbline::internal {
namespace {

double MeanSpeed(const RollingWheel& wheel, std::size_t first, std::size_t last) {
  return (wheel.frames[first].speed_rad_s + wheel.frames[last].speed_rad_s) / 2;
}

// Of the slope of the parabola through three angles, f in the middle: by what each frame says of
// its own, by what they have in common, and by how far places disagree on the turns beside f. Of
// two, and where a channel tells the turns, that of the smoothed speed.
double SigmaOfSlope(const RollingWheel& wheel, std::size_t first, std::size_t f,
                    std::span<const double> weights) {
  const RollingFrame& frame = wheel.frames[f];
  if (weights.size() < 3 || std::isfinite(frame.channel_lean)) return frame.sigma_random_rad_s;
  double variance = 0;
  Eigen::VectorXd common = Eigen::VectorXd::Zero(wheel.angle_along_reference_rad.rows());
  for (std::size_t k = 0; k < weights.size(); ++k) {
    variance += std::pow(weights[k] * wheel.frames[first + k].sigma_measured_rad, 2);
    common +=
        weights[k] * wheel.angle_along_reference_rad.col(static_cast<Eigen::Index>(first + k));
  }
  const double spread = wheel.deformation.SpeedSpread(f, frame.time_s - wheel.frames[f - 1].time_s,
                                                      wheel.frames[f + 1].time_s - frame.time_s);
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
  const double middle_s = poses[1].time_s;
  const double half_way_s = ((begins ? poses[0].time_s : poses[2].time_s) - middle_s) / 2;
  const std::array<double, 3> bend = BendWeights({poses[0].time_s, middle_s, poses[2].time_s});
  const Eigen::MatrixXd root = RandomRoot(poses);
  double change = 0;
  Eigen::RowVectorXd error = Eigen::RowVectorXd::Zero(root.cols());
  for (std::size_t k = 0; k < 3; ++k) {
    change += half_way_s * bend[k] * poses[k].pose[0];
    error += half_way_s * bend[k] * root.row(3 * static_cast<Eigen::Index>(k));
  }
  return {change, error.norm()};
}

}  // namespace

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
