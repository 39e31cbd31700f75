#include "track/wheel_speed_channel.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kClock_s = 0.237, kNoise_rad_s = 3.6e-3, kFrame_s = 0.02, kSpeed_rad_s = 3.6;
constexpr double kGrowth_rad_s2 = 2;

double AngleAt(double t) { return 1 + kSpeed_rad_s * t + kGrowth_rad_s2 / 2 * t * t; }
double SpeedAt(double t) { return kSpeed_rad_s + kGrowth_rad_s2 * t; }

// 200 samples a second, or as many unevenly spaced ones.
WheelSpeedChannel Logged(std::mt19937& rng, double noise_rad_s, bool evenly = true) {
  std::normal_distribution<double> n(0, 1);
  std::uniform_real_distribution<double> step(0.2, 1.8);
  WheelSpeedChannel channel;
  for (double t = -0.1; t < 0.7; t += 0.005 * (evenly ? 1 : step(rng))) {
    channel.speed_rad_s.time_s.push_back(t + kClock_s);
    channel.speed_rad_s.value.push_back(SpeedAt(t) + noise_rad_s * n(rng));
  }
  channel.clock_offset_s = kClock_s;
  return channel;
}

std::vector<double> FrameTimes(int frames) {
  std::vector<double> times;
  for (int f = 0; f < frames; ++f) times.push_back(kFrame_s * f + 1e-3);
  return times;
}

// A recording as the survey leaves it.
struct Recording {
  std::vector<double> drift_rad;
  RollingWheel wheel;

  // drawn: one sigma of what all of the surface is drawn along by from frame to frame; told: how
  // much of that the places disagree by; rig: how far the rig has turned by a time.
  Recording(
      std::mt19937& rng, double drawn_rad, double told_rad,
      const std::function<double(double)>& rig = [](double) { return 0.0; }, int frames = 24) {
    std::normal_distribution<double> n(0, 1);
    double drift = 0;
    wheel.deformation.steady = drawn_rad == 0;
    int f = 0;
    for (const double t : FrameTimes(frames)) {
      if (f > 0) drift += drawn_rad * n(rng);
      RollingFrame frame;
      frame.index = f++;
      frame.time_s = t;
      frame.status = RollingFrameStatus::kPlaced;
      frame.sigma_measured_rad = drawn_rad > 0 ? 2e-5 : 5e-7;
      frame.measured_angle_rad = AngleAt(t) + rig(t) + drift + frame.sigma_measured_rad * n(rng);
      frame.angle_rad = frame.measured_angle_rad;
      frame.speed_rad_s = SpeedAt(t);
      wheel.frames.push_back(frame);
      wheel.deformation.frames.push_back(
          {frame.measured_angle_rad, frame.sigma_measured_rad, 1, f > 1 ? told_rad : 0});
      drift_rad.push_back(drift);
    }
    wheel.deformation.along_modes.resize(0, frames);
    wheel.angle_along_modes_rad.resize(0, frames);
    wheel.speed_along_modes_rad_s.resize(0, frames);
  }
};

TEST(ChannelTurns, AreTheIntegralOfTheLinesBetweenSamples) {
  std::mt19937 rng(1);
  WheelSpeedChannel channel = Logged(rng, 0, false);
  channel.sigma_rad_s = kNoise_rad_s;
  channel.sigma_clock_offset_s = 1e-3;
  const std::vector<double> times = {0, 0.013, 0.0131, 0.05, 0.2};
  const ChannelTurns turns = TurnsByChannel(channel, times);
  for (std::size_t i = 0; i + 1 < times.size(); ++i) {
    EXPECT_NEAR(turns.turn_rad[i], AngleAt(times[i + 1]) - AngleAt(times[i]), 1e-12);
    EXPECT_NEAR(turns.along_clock_rad[i], 1e-3 * kGrowth_rad_s2 * (times[i + 1] - times[i]), 1e-12);
  }
  EXPECT_EQ(turns.gaps, 0);
}

TEST(ChannelTurns, AddUpWithTheSigmaTheyClaim) {
  constexpr int kDraws = 3000;
  const std::vector<double> times = FrameTimes(24);
  for (const bool evenly : {true, false}) {
    double chi2 = 0, one = 0;
    for (unsigned seed = 0; seed < kDraws; ++seed) {
      std::mt19937 rng(seed);
      WheelSpeedChannel channel = Logged(rng, kNoise_rad_s, evenly);
      channel.sigma_rad_s = kNoise_rad_s;
      const ChannelTurns turns = TurnsByChannel(channel, times);
      double sum = 0, variance = 0;
      for (std::size_t i = 0; i + 1 < times.size(); ++i) {
        sum += turns.turn_rad[i];
        variance += std::pow(turns.sigma_rad[i], 2);
      }
      chi2 += std::pow(sum - (AngleAt(times.back()) - AngleAt(times.front())), 2) / variance;
      one += std::pow(
          (turns.turn_rad[5] - (AngleAt(times[6]) - AngleAt(times[5]))) / turns.sigma_rad[5], 2);
    }
    EXPECT_NEAR(chi2 / kDraws, 1, 0.1) << evenly;
    // One alone is claimed a little too large: what it shares with its neighbours counts in full.
    EXPECT_GT(one / kDraws, 0.7) << evenly;
    EXPECT_LT(one / kDraws, 1.05) << evenly;
  }
}

TEST(ChannelTurns, TellTheNoiseOfTheSamplesFromTheirScatter) {
  const std::vector<double> times = FrameTimes(20);
  constexpr int kDraws = 40;
  double mean_rad_s = 0;
  for (unsigned seed = 0; seed < kDraws; ++seed) {
    std::mt19937 draw(seed);
    WheelSpeedChannel logged = Logged(draw, kNoise_rad_s, false);
    logged.speed_rad_s.value[20] += 1;  // one bad sample does not change it
    mean_rad_s += TurnsByChannel(logged, times).sigma_sample_rad_s / kDraws;
  }
  EXPECT_NEAR(mean_rad_s, kNoise_rad_s, 0.05 * kNoise_rad_s);
  std::mt19937 rng(3);
  WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
  std::fill(channel.speed_rad_s.value.begin(), channel.speed_rad_s.value.end(), 3.6);
  EXPECT_EQ(TurnsByChannel(channel, times).sigma_sample_rad_s, 0);
  Recording recording(rng, 0, 1e-8);
  EXPECT_THAT(LeanOnChannel(channel, {}, {}, &recording.wheel).problem, HasSubstr("noise"));
  channel.sigma_rad_s = 0.1;
  EXPECT_EQ(TurnsByChannel(channel, times).sigma_sample_rad_s, 0.1);
}

TEST(ChannelTurns, AreNotToldOverGapsAndBeyondTheEnds) {
  std::mt19937 rng(4);
  WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
  for (std::size_t k = 0; k < channel.speed_rad_s.time_s.size(); ++k) {
    const double t = channel.speed_rad_s.time_s[k] - kClock_s;
    if ((t > 0.1 && t < 0.125) || t > 0.3) channel.speed_rad_s.value[k] = kNone;
  }
  const std::vector<double> times = FrameTimes(20);
  const ChannelTurns turns = TurnsByChannel(channel, times);
  int gaps = 0;
  for (std::size_t i = 0; i + 1 < times.size(); ++i) {
    const bool gap = (times[i] < 0.125 && times[i + 1] > 0.1) || times[i + 1] > 0.3;
    EXPECT_EQ(std::isnan(turns.turn_rad[i]), gap) << times[i];
    gaps += gap ? 1 : 0;
  }
  EXPECT_EQ(turns.gaps, gaps);
  const std::vector<double> back = {0, 0.1, 0.1};
  EXPECT_THROW((void)TurnsByChannel(channel, back), std::invalid_argument);
}

struct Errors {
  double nees = 0, inside = 0, rms_rad = 0, images_rms_rad = 0, lean = 0;
};

// Of the turn since the first frame, over obstacles; change: of what is known of the channel.
Errors ErrorsOver(unsigned draws,
                  const std::function<void(std::mt19937&, WheelSpeedChannel*)>& change) {
  Errors sum;
  double count = 0;
  for (unsigned seed = 1; seed <= draws; ++seed) {
    std::mt19937 rng(seed);
    Recording recording(rng, 6e-4, 4e-4);
    WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
    change(rng, &channel);
    AngleSmootherOptions options;
    options.jerk_rad_s25 = 1;
    RollingWheel& wheel = recording.wheel;
    const ChannelLean lean = LeanOnChannel(channel, {}, options, &wheel);
    EXPECT_TRUE(lean.used) << lean.problem;
    sum.lean += lean.lean / draws;
    const double first = wheel.frames[0].angle_rad - AngleAt(wheel.frames[0].time_s);
    for (std::size_t f = 1; f < wheel.frames.size(); ++f) {
      const RollingFrame& frame = wheel.frames[f];
      const double off = frame.angle_rad - AngleAt(frame.time_s) - first;
      sum.nees += std::pow(off / frame.sigma_random_rad, 2);
      sum.inside += std::abs(off) < 1.96 * frame.sigma_random_rad ? 1 : 0;
      sum.rms_rad += off * off;
      sum.images_rms_rad += std::pow(recording.drift_rad[f], 2);
      count += 1;
    }
  }
  return {sum.nees / count, sum.inside / count, std::sqrt(sum.rms_rad / count),
          std::sqrt(sum.images_rms_rad / count), sum.lean};
}

TEST(WheelSpeedChannel, TellsTheTurnOverObstacles) {
  const Errors errors = ErrorsOver(600, [](std::mt19937&, WheelSpeedChannel*) {});
  EXPECT_NEAR(errors.nees, 1, 0.12);
  EXPECT_NEAR(errors.inside, 0.95, 0.02);
  EXPECT_LT(errors.rms_rad, 0.1 * errors.images_rms_rad);
  EXPECT_GT(errors.lean, 0.97);
}

TEST(WheelSpeedChannel, CountsTheErrorsOfTheClockAndTheScale) {
  std::normal_distribution<double> n(0, 1);
  constexpr double kSigmaClock_s = 5e-3, kSigmaScale = 0.003;
  const Errors clock = ErrorsOver(600, [&](std::mt19937& rng, WheelSpeedChannel* channel) {
    channel->sigma_clock_offset_s = kSigmaClock_s;
    channel->clock_offset_s += kSigmaClock_s * n(rng);
  });
  EXPECT_NEAR(clock.nees, 1, 0.15);
  const Errors scale = ErrorsOver(600, [&](std::mt19937& rng, WheelSpeedChannel* channel) {
    channel->sigma_scale = kSigmaScale;
    const double factor = 1 + kSigmaScale * n(rng);
    for (double& speed : channel->speed_rad_s.value) speed *= factor;
  });
  EXPECT_NEAR(scale.nees, 1, 0.15);
  EXPECT_GT(scale.rms_rad, 5 * ErrorsOver(100, [](std::mt19937&, WheelSpeedChannel*) {}).rms_rad);
}

TEST(WheelSpeedChannel, ChangesNextToNothingOnEvenGround) {
  std::mt19937 rng(5);
  Recording recording(rng, 0, 1e-8);
  const RollingWheel before = recording.wheel;
  const ChannelLean lean = LeanOnChannel(Logged(rng, kNoise_rad_s), {}, {}, &recording.wheel);
  ASSERT_TRUE(lean.used) << lean.problem;
  EXPECT_LT(lean.lean, 0.002);
  EXPECT_EQ(lean.drawn_along_rad, 0);
  for (std::size_t f = 0; f < before.frames.size(); ++f) {
    const RollingFrame& frame = recording.wheel.frames[f];
    EXPECT_NEAR(frame.angle_rad, before.frames[f].measured_angle_rad, 2e-6);
    EXPECT_LT(frame.sigma_random_rad, 6e-7);
    EXPECT_LT(frame.channel_lean, 0.01);
  }
}

// The rig swings by three degrees; its turn over the ground is known to 1e-5 rad.
TEST(WheelSpeedChannel, IsToldAgainstTheRigOrOverTheGround) {
  const auto rig = [](double t) { return 0.05 * std::sin(9 * t); };
  std::mt19937 rng(6);
  Recording recording(rng, 6e-4, 4e-4, rig);
  std::vector<RigRotationFrame> rotation(recording.wheel.frames.size());
  for (std::size_t f = 0; f < rotation.size(); ++f) {
    rotation[f].known.fill(true);
    rotation[f].pose[0] = rig(recording.wheel.frames[f].time_s);
    rotation[f].sigma_random.setConstant(1e-5);
  }
  const WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
  RollingWheel against_rig = recording.wheel;
  EXPECT_THAT(LeanOnChannel(channel, {}, {}, &against_rig).problem, HasSubstr("contradicts"));
  RollingWheel& wheel = recording.wheel;
  const ChannelLean lean = LeanOnChannel(channel, rotation, {}, &wheel);
  ASSERT_TRUE(lean.used) << lean.problem;
  for (const RollingFrame& frame : wheel.frames) {
    const double off = frame.angle_rad - wheel.frames[0].angle_rad -
                       (AngleAt(frame.time_s) + rig(frame.time_s) -
                        AngleAt(wheel.frames[0].time_s) - rig(wheel.frames[0].time_s));
    EXPECT_NEAR(off, 0, 4 * frame.sigma_random_rad);
    EXPECT_NEAR(off, 0, 6e-4);
  }
  const SampledSignal over_ground = WheelSpeedsOf(wheel, rotation);
  for (std::size_t i = 1; i + 1 < over_ground.value.size(); ++i) {
    EXPECT_NEAR(over_ground.value[i], SpeedAt(over_ground.time_s[i]), 0.02);
  }
  rotation[7].known.fill(false);
  EXPECT_EQ(LeanOnChannel(channel, rotation, {}, &wheel).gaps, 2);
  for (RigRotationFrame& frame : rotation) frame.known.fill(false);
  EXPECT_THAT(LeanOnChannel(channel, rotation, {}, &wheel).problem, HasSubstr("over the ground"));
  rotation.pop_back();
  EXPECT_THROW((void)LeanOnChannel(channel, rotation, {}, &wheel), std::invalid_argument);
}

TEST(WheelSpeedChannel, ThatContradictsTheImagesIsNotUsed) {
  const auto refused = [](double drawn_rad, const std::function<void(WheelSpeedChannel*)>& spoil) {
    std::mt19937 rng(7);
    Recording recording(rng, drawn_rad, drawn_rad / 2 + 1e-8);
    const RollingWheel before = recording.wheel;
    WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
    spoil(&channel);
    const ChannelLean lean = LeanOnChannel(channel, {}, {}, &recording.wheel);
    EXPECT_FALSE(lean.used);
    EXPECT_EQ(recording.wheel.frames[9].angle_rad, before.frames[9].angle_rad);
    EXPECT_TRUE(std::isnan(recording.wheel.frames[9].channel_lean));
    return lean.problem;
  };
  for (const double drawn_rad : {0.0, 6e-4}) {
    EXPECT_THAT(refused(drawn_rad,
                        [](WheelSpeedChannel* channel) {
                          for (double& v : channel->speed_rad_s.value) v *= 30 / M_PI;  // rpm
                        }),
                HasSubstr("in another unit"));
    EXPECT_THAT(
        refused(drawn_rad, [](WheelSpeedChannel* channel) { channel->clock_offset_s += 0.09; }),
        HasSubstr("clock's offset"));
  }
  EXPECT_THAT(refused(0, [](WheelSpeedChannel* channel) { channel->clock_offset_s = 50; }),
              HasSubstr("does not reach"));
}

TEST(WheelSpeedChannel, CalibrationModesChangeLessOfTheTurn) {
  std::mt19937 rng(8);
  Recording recording(rng, 6e-4, 4e-4);
  RollingWheel& wheel = recording.wheel;
  const auto frames = static_cast<Eigen::Index>(wheel.frames.size());
  Eigen::MatrixXd along(2, frames);
  for (Eigen::Index f = 0; f < frames; ++f) along.col(f) << 1e-4, 1e-4 * static_cast<double>(f);
  wheel.deformation.along_modes = wheel.angle_along_modes_rad = along;
  wheel.speed_along_modes_rad_s = Eigen::MatrixXd::Zero(2, frames);
  ASSERT_TRUE(LeanOnChannel(Logged(rng, kNoise_rad_s), {}, {}, &wheel).used);
  const Eigen::MatrixXd& after = wheel.angle_along_modes_rad;
  EXPECT_NEAR(after(0, frames - 1), 1e-4, 1e-6);
  EXPECT_LT(after(1, frames - 1) - after(1, 0), 0.1 * along(1, frames - 1));
  EXPECT_NEAR(wheel.frames.back().sigma_calibration_rad, after.col(frames - 1).norm(), 1e-12);
}

TEST(WheelSpeedChannel, RefusesWhatMakesNoSense) {
  std::mt19937 rng(9);
  Recording recording(rng, 0, 1e-8);
  const auto refused = [&](const std::function<void(WheelSpeedChannel*)>& spoil) {
    WheelSpeedChannel channel = Logged(rng, kNoise_rad_s);
    spoil(&channel);
    EXPECT_THROW((void)LeanOnChannel(channel, {}, {}, &recording.wheel), UsageError);
  };
  refused([](WheelSpeedChannel* channel) { channel->sigma_rad_s = 0; });
  refused([](WheelSpeedChannel* channel) { channel->sigma_scale = -0.1; });
  refused([](WheelSpeedChannel* channel) { channel->clock_offset_s = kNone; });
  refused([](WheelSpeedChannel* channel) { channel->sigma_clock_offset_s = -1; });
  refused([](WheelSpeedChannel* channel) { channel->speed_rad_s.value.pop_back(); });
  for (RollingFrame& frame : recording.wheel.frames) frame.time_s = kNone;
  EXPECT_THAT(LeanOnChannel(Logged(rng, kNoise_rad_s), {}, {}, &recording.wheel).problem,
              HasSubstr("no times"));
}

}  // namespace
}  // namespace plumbline
