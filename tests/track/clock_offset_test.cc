#include "track/clock_offset.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr double kOffset_s = 0.2371;
using Quantity = std::function<double(double time_s)>;

// A speed that swings ever faster.
double Speed(double t) { return 3.6 + 0.3 * std::sin(1.1 * t + 0.35 * t * t); }

struct Recorder {
  double rate_hz, begin_s, end_s;
  double clock_s = 0;      // that it reads at time 0
  double averaging_s = 0;  // of its values
  double noise = 0, gain = 1, bias = 0;

  SampledSignal Record(const Quantity& quantity, std::mt19937& random) const {
    std::normal_distribution<double> normal;
    SampledSignal signal;
    for (double t = begin_s; t <= end_s; t += 1 / rate_hz) {
      double mean = 0;
      constexpr int kParts = 20;
      for (int k = 0; k < kParts; ++k) {
        mean += quantity(t + averaging_s * ((k + 0.5) / kParts - 0.5)) / kParts;
      }
      signal.time_s.push_back(t + clock_s);
      signal.value.push_back(gain * mean + bias + noise * normal(random));
    }
    return signal;
  }
};

const Recorder kImages{
    .rate_hz = 50, .begin_s = 0, .end_s = 6, .averaging_s = 0.04, .noise = 0.004};
const Recorder kLogger{
    .rate_hz = 200, .begin_s = -0.5, .end_s = 6.5, .clock_s = kOffset_s, .noise = 0.004};

TEST(ClockOffset, IsFoundWithinItsSigma) {
  constexpr int kDraws = 200;
  double squares = 0, sigma = 0;
  int covered = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::mt19937 random(static_cast<std::uint32_t>(draw));
    const SampledSignal ours = kImages.Record(Speed, random);
    const SampledSignal theirs = kLogger.Record(Speed, random);
    const ClockOffset found = FindClockOffset(ours, theirs, {.most_s = 2, .averaging_s = 0.04});
    const double error = found.offset_s - kOffset_s;
    squares += std::pow(error / found.sigma_s, 2);
    covered += std::abs(error) < 1.96 * found.sigma_s ? 1 : 0;
    sigma += found.sigma_s / kDraws;
    EXPECT_NEAR(found.gain, 1, 0.01);
    EXPECT_GT(found.correlation, 0.99);
  }
  EXPECT_NEAR(squares / kDraws, 1, 0.25);
  EXPECT_GE(covered, kDraws * 91 / 100);
  EXPECT_LT(sigma, 0.0006);
}

TEST(ClockOffset, IsFoundFarOffInOtherUnitsAndWithDropouts) {
  std::mt19937 random(1);
  Recorder logger = kLogger;
  logger.clock_s = -7.5;
  logger.gain = 1.4;  // km/h for rad/s
  logger.bias = 0.2;
  SampledSignal ours = kImages.Record(Speed, random);
  SampledSignal theirs = logger.Record(Speed, random);
  for (std::size_t i = 0; i < theirs.value.size(); i += 9) theirs.value[i] = NAN;
  ours.value[100] = NAN;
  const ClockOffset found = FindClockOffset(ours, theirs, {.averaging_s = 0.04});
  EXPECT_NEAR(found.offset_s, -7.5, 5 * found.sigma_s);
  EXPECT_NEAR(found.gain, 1 / 1.4, 0.01);
  EXPECT_EQ(found.samples, 300);
}

TEST(ClockOffset, IsFoundBetweenRecordingsThatOverlapInPart) {
  std::mt19937 random(2);
  Recorder logger = kLogger;
  logger.begin_s = 2.5;
  logger.end_s = 30;
  const ClockOffset found = FindClockOffset(kImages.Record(Speed, random),
                                            logger.Record(Speed, random), {.averaging_s = 0.04});
  EXPECT_NEAR(found.offset_s, kOffset_s, 5 * found.sigma_s);
  EXPECT_LT(found.samples, 200);
}

void ExpectRefusal(const Quantity& quantity, const std::string& says,
                   const ClockOffsetOptions& options = {}) {
  std::mt19937 random(3);
  const SampledSignal ours = kImages.Record(quantity, random);
  const SampledSignal theirs = kLogger.Record(quantity, random);
  try {
    const ClockOffset found = FindClockOffset(ours, theirs, options);
    FAIL() << "found " << found.offset_s << ", runner-up " << found.runner_up;
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find(says), std::string::npos) << error.what();
  }
}

TEST(ClockOffset, IsNotGuessedWhereTheSignalsDoNotTellIt) {
  ExpectRefusal([](double) { return 3.6; }, "correlate by");
  ExpectRefusal([](double t) { return 3.6 + 0.3 * std::sin(2 * std::numbers::pi * t); },
                "periodic");
  ExpectRefusal(Speed, "may lie beyond", {.most_s = 0.05});
}

TEST(ClockOffset, NeedsSignalsThatOverlap) {
  std::mt19937 random(4);
  Recorder logger = kLogger;
  logger.begin_s = 40;
  logger.end_s = 60;
  const SampledSignal ours = kImages.Record(Speed, random);
  const SampledSignal theirs = logger.Record(Speed, random);
  EXPECT_THROW(FindClockOffset(ours, theirs), InputError);
}

TEST(ClockOffset, RefusesSignalsThatAreTooShortOrConstant) {
  const SampledSignal flat{{0, 1, 2, 3, 4, 5, 6, 7, 8}, std::vector<double>(9, 1)};
  const SampledSignal few{{0, 1}, {0, 1}};
  EXPECT_THROW(FindClockOffset(flat, flat), InputError);
  EXPECT_THROW(FindClockOffset(few, few), InputError);
  EXPECT_THROW(FindClockOffset(few, few, {.most_s = 0}), UsageError);
}

}  // namespace
}  // namespace plumbline
