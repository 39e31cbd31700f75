#include "track/internal/turning_over_ground.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <span>
#include <vector>

#include "track/internal/finite_differences.h"

namespace plumbline {
namespace {

constexpr double kOmega = 3.6, kStep_s = 0.02;  // over the ground, rad/s
constexpr double kSigmaPose_rad = 2e-5, kSigmaSpeed_rad_s = 3e-4;

// A wheel that turns evenly over the ground while the arm that holds the rig swings faster and
// faster: by its rate of turning, p' = a t, the rig sees the wheel turn faster too.
struct Swing {
  RollingWheel wheel;
  std::vector<RigRotationFrame> poses;

  explicit Swing(double a_rad_s2, std::size_t frames = 5, double speeding_up = 0) {
    for (std::size_t f = 0; f < frames; ++f) {
      const double t = kStep_s * static_cast<double>(f);
      RollingFrame& frame = wheel.frames.emplace_back();
      frame.time_s = t;
      frame.speed_rad_s = kOmega * (1 + speeding_up * t) + a_rad_s2 * t;
      frame.sigma_random_rad_s = kSigmaSpeed_rad_s;
      RigRotationFrame& pose = poses.emplace_back();
      pose.time_s = t;
      pose.known = {true, true, true};
      pose.pose[0] = a_rad_s2 * t * t / 2;
      pose.errors.cov(0, 0) = kSigmaPose_rad * kSigmaPose_rad;
    }
  }
  internal::SpeedRatio Begin() const {
    return internal::SpeedAtEnd(wheel, 0, 0, 1, std::span(poses).first(3));
  }
  internal::SpeedRatio End() const {
    const std::size_t last = poses.size() - 1;
    return internal::SpeedAtEnd(wheel, last - 1, last, last, std::span(poses).last(3));
  }
};

// The frame after the one that is looked at is lost.
struct SwingWithAGap : Swing {
  SwingWithAGap() : Swing(3, 5, 0.5) {
    for (RollingFrame& frame : wheel.frames) {
      const double t = frame.time_s;
      frame.angle_rad = kOmega * (t + 0.25 * t * t) + 3 * t * t / 2;
      frame.sigma_measured_rad = kSigmaAngle_rad;
    }
    wheel.frames.erase(wheel.frames.begin() + 3);
    poses.erase(poses.begin() + 3);
    wheel.speed_along_modes_rad_s = Eigen::MatrixXd::Zero(0, 4);
    wheel.angle_along_reference_rad = Eigen::MatrixXd::Zero(1, 4);
    wheel.angle_along_reference_rad << 0, 1e-5, 3e-5, 1e-5;
    wheel.deformation.frames.resize(4);
  }
  MeasuredScalar Turning() const {
    const std::vector<double> times = {kStep_s, 2 * kStep_s, 4 * kStep_s};
    return internal::TurningOverGround(wheel, 1, 2, std::span(poses).last(3),
                                       internal::SlopeWeights(times, 1));
  }
  static constexpr double kSigmaAngle_rad = 2e-5;
};

TEST(TurningOverGround, TakesTheSwingOfTheArmOutBesideAFrameThatIsLost) {
  EXPECT_NEAR(SwingWithAGap().Turning().value, kOmega * (1 + 0.5 * 2 * kStep_s), 1e-12);
}

TEST(TurningOverGround, SigmaIsThatOfSampling) {
  const SwingWithAGap swing;
  constexpr int kDraws = 4000;
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const MeasuredScalar exact = swing.Turning();
  double squares = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    SwingWithAGap off = swing;
    const double common = normal(random);
    for (std::size_t f = 0; f < off.wheel.frames.size(); ++f) {
      off.wheel.frames[f].angle_rad +=
          SwingWithAGap::kSigmaAngle_rad * normal(random) +
          common * swing.wheel.angle_along_reference_rad(0, static_cast<Eigen::Index>(f));
    }
    squares += std::pow((off.Turning().value - exact.value) / exact.sigma_random, 2) / kDraws;
  }
  EXPECT_NEAR(squares, 1, 4 * std::sqrt(2.0 / kDraws));
  // What places disagree by on a turn counts over its time; a channel tells turns without that.
  SwingWithAGap disagreeing = swing;
  disagreeing.wheel.deformation.frames[3].turn_spread_rad = 1e-3;
  EXPECT_NEAR(disagreeing.Turning().sigma_random,
              std::hypot(exact.sigma_random, 1e-3 / (2 * kStep_s)), 1e-9);
  disagreeing.wheel.frames[2].channel_lean = 0.9;
  EXPECT_EQ(disagreeing.Turning().sigma_random, kSigmaSpeed_rad_s);
}

TEST(SpeedAtEnd, AnArmThatSwingsFasterAndFasterDoesNotSpeedUpTheWheel) {
  const Swing swing(3);
  EXPECT_NEAR(swing.Begin().value, 1, 1e-12);
  EXPECT_NEAR(swing.End().value, 1, 1e-12);
}

TEST(SpeedAtEnd, FollowsAWheelThatSpeedsUpWhateverTheArmDoes) {
  for (const double a : {0.0, 3.0}) {
    const Swing swing(a, 5, 0.5);
    const double end_s = 4 * kStep_s;
    EXPECT_NEAR(swing.Begin().value, 1 / (1 + 0.25 * kStep_s), 1e-12);
    EXPECT_NEAR(swing.End().value, (1 + 0.5 * end_s) / (1 + 0.5 * (end_s - kStep_s / 2)), 1e-12);
  }
}

TEST(SpeedAtEnd, TakesTheGroundToTurnEvenlyWhereNoThirdFrameTells) {
  Swing swing(3);
  swing.poses[2].known[0] = false;
  const double half_step = 3 * kStep_s / 2 / kOmega;  // what the arm's swing changes meanwhile
  EXPECT_NEAR(swing.Begin().value, 1 - half_step, 1e-12);
  const Swing two(3, 2);
  EXPECT_NEAR(internal::SpeedAtEnd(two.wheel, 0, 0, 1, two.poses).value, 1 - half_step, 1e-12);
}

TEST(SpeedAtEnd, SigmaIsThatOfSampling) {
  const Swing swing(3, 5, 0.5);
  constexpr int kDraws = 4000;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  double begin = 0, end = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    Swing off = swing;
    for (RigRotationFrame& pose : off.poses) pose.pose[0] += kSigmaPose_rad * normal(random);
    for (RollingFrame& frame : off.wheel.frames) {
      frame.speed_rad_s += kSigmaSpeed_rad_s * normal(random);
    }
    begin += std::pow((off.Begin().value - swing.Begin().value) / swing.Begin().sigma, 2) / kDraws;
    end += std::pow((off.End().value - swing.End().value) / swing.End().sigma, 2) / kDraws;
  }
  const double within = 4 * std::sqrt(2.0 / kDraws);
  EXPECT_NEAR(begin, 1, within);
  EXPECT_NEAR(end, 1, within);
}

}  // namespace
}  // namespace plumbline
