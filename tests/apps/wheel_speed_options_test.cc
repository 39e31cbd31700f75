#include "apps/internal/wheel_speed_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "apps/internal/wheel_lean.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

struct Said {
  WheelSpeedOptionSet options;
  CLI::App app;
  OptionTable table{app, "measure"};

  explicit Said(std::vector<std::string> arguments) {
    options.Declare(table);
    std::reverse(arguments.begin(), arguments.end());
    app.parse(std::move(arguments));
    table.Finish();
  }
};

double SpeedAt(double t) { return 3.6 + 0.3 * std::sin(1.1 * t + 0.35 * t * t); }

// 6 s at 200 samples a second of a logger that is 0.25 s ahead.
std::vector<Channel> Logged(const std::string& units, double factor) {
  Channel channel{"omega", units, "", {}, {}};
  for (double t = -0.5; t < 6.5; t += 0.005) {
    channel.time_s.push_back(t + 0.25);
    channel.value.push_back(factor * SpeedAt(t) + 1e-4 * std::sin(1e3 * t));
  }
  return {channel};
}

SampledSignal ByImages() {
  SampledSignal speeds;
  for (double t = 0; t < 6; t += 0.02) {
    speeds.time_s.push_back(t);
    speeds.value.push_back(SpeedAt(t) + 1e-3 * std::sin(777 * t));
  }
  return speeds;
}

TEST(WheelSpeedOptions, TellTheClockAndTheSpeedInRadians) {
  const Said said({"--wheel-speed", "omega"});
  EXPECT_TRUE(said.options.over_ground());
  for (const auto& [units, factor] :
       {std::pair{"rad/s", 1.0}, {"deg/s", 180 / M_PI}, {"rpm", 30 / M_PI}, {"1/min", 30 / M_PI}}) {
    std::vector<Channel> channels = Logged(units, factor);
    std::string problem;
    EXPECT_FALSE(said.options.Speeds(channels, &problem));
    EXPECT_THAT(problem, HasSubstr("clock"));
    EXPECT_THAT(said.options.FindClock(ByImages(), &channels), HasSubstr("reads 0.2"));
    const auto speeds = said.options.Speeds(channels, &problem);
    ASSERT_TRUE(speeds.has_value()) << problem;
    EXPECT_NEAR(speeds->clock_offset_s, 0.25, 1e-3);
    EXPECT_GT(speeds->sigma_clock_offset_s, 0);
    EXPECT_NEAR(speeds->speed_rad_s.value[0], SpeedAt(-0.5), 1e-3);
    EXPECT_FALSE(speeds->sigma_rad_s.has_value());
  }
  std::string problem;
  EXPECT_FALSE(said.options.Speeds(Logged("km/h", 1), &problem));
  EXPECT_THAT(problem, HasSubstr("'km/h' is not a unit of turning"));
}

TEST(WheelSpeedOptions, KeepAClockThatIsSurer) {
  const Said said({"--wheel-speed", "omega", "--wheel-speed-against", "rig", "--wheel-speed-sigma",
                   "0.01", "--wheel-speed-scale-sigma", "0.002"});
  EXPECT_FALSE(said.options.over_ground());
  std::vector<Channel> channels = Logged("rad/s", 1);
  channels[0].clock_offset_s = 0.249;
  channels[0].sigma_clock_offset_s = 1e-9;
  EXPECT_THAT(said.options.FindClock(ByImages(), &channels), HasSubstr("is surer than 0.2"));
  EXPECT_EQ(channels[0].clock_offset_s, 0.249);
  std::string problem;
  const auto speeds = said.options.Speeds(channels, &problem);
  ASSERT_TRUE(speeds.has_value());
  EXPECT_EQ(speeds->sigma_rad_s, 0.01);
  EXPECT_EQ(speeds->sigma_scale, 0.002);
  channels[0].sigma_clock_offset_s = 1;
  EXPECT_THAT(said.options.FindClock(ByImages(), &channels), HasSubstr("reads 0.2"));
  EXPECT_NEAR(channels[0].clock_offset_s, 0.25, 1e-3);
}

TEST(WheelSpeedOptions, RefuseAChannelThatIsNotThere) {
  EXPECT_THROW(Said({"--wheel-speed", "w"}).options.Check(Logged("rad/s", 1)), UsageError);
  EXPECT_THROW(Said({"--wheel-speed-sigma", "1"}).options.Check({}), UsageError);
  EXPECT_NO_THROW(Said({}).options.Check({}));
}

TEST(WheelSpeedOptions, TheNoteSaysHowMuchTheAngleLeansOnTheChannel) {
  ChannelLean lean;
  lean.problem = "it is of another wheel";
  EXPECT_THAT(TextOf(lean), HasSubstr("does not lean on the channel of its speed: it is of"));
  lean.used = true;
  lean.lean = 0.93;
  EXPECT_THAT(TextOf(lean), HasSubstr("93 % of its turn"));
  EXPECT_THAT(TextOf(lean), Not(HasSubstr("gaps")));
  lean.gaps = 2;
  lean.outliers = 1;
  lean.drawn_along_rad = 0.001;
  EXPECT_THAT(TextOf(lean), HasSubstr("2 turns"));
  EXPECT_THAT(TextOf(lean), HasSubstr("1 contradict"));
  EXPECT_THAT(TextOf(lean), HasSubstr("0.057 degrees"));
}

}  // namespace
}  // namespace plumbline::internal
