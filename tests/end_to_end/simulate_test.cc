// The virtual rig as a user meets it: simulate, calibrate, measure, compare.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "io/inspect.h"
#include "io/virtual_rig/scenario.h"
#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::RunPlumbline;

std::string TextOf(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

TEST(Simulate, ListNamesEveryScenarioWithOneLine) {
  const auto list = RunPlumbline("simulate list");
  EXPECT_EQ(list.exit_code, 0);
  for (const ScenarioEntry& entry : ListScenarios()) {
    EXPECT_THAT("\n" + list.output, HasSubstr("\n" + entry.name + " ")) << entry.name;
    EXPECT_THAT(list.output, HasSubstr(entry.summary + "\n"));
  }
}

// What the demo does, on fewer frames: the errors against truth are what they were said to be.
TEST(Simulate, IsCalibratedMeasuredAndComparedLikeARealRecording) {
  const fs::path folder = testing::TestFolder();
  const std::string sim = (folder / "sim").string();
  const auto simulated =
      RunPlumbline("simulate tyre-flat -q --frame-count 2 --calibration 16 -o " + sim);
  ASSERT_EQ(simulated.exit_code, 0) << simulated.output;
  const auto calibrated = RunPlumbline(
      "calibrate -q --board charuco:11x8:12mm:9mm:DICT_5X5_100 --left " + sim +
      "/calibration/left --right " + sim + "/calibration/right -o " + (folder / "rig.h5").string());
  ASSERT_EQ(calibrated.exit_code, 0) << calibrated.output;
  const auto measured =
      RunPlumbline("measure -q --rig " + (folder / "rig.h5").string() + " --left " + sim +
                   "/left --right " + sim + "/right --timestamps " + sim +
                   "/timestamps.csv --step 6 -o " + (folder / "run.h5").string());
  ASSERT_EQ(measured.exit_code, 0) << measured.output;
  const auto compared = RunPlumbline("compare --json " + (folder / "run.h5").string() + " " + sim);
  ASSERT_EQ(compared.exit_code, 0) << compared.output;
  const auto json = nlohmann::json::parse(compared.output);
  ASSERT_EQ(json["frames"].size(), 2U);
  for (const auto& frame : json["frames"]) {
    EXPECT_GT(frame["points"], 4000);
    // The sides of the view, steep and blurred, are the worst of it.
    EXPECT_LT(frame["median_height_error_mm"], 0.08);
    EXPECT_LT(frame["rms_distance_mm"], 0.3);
    EXPECT_GT(frame["within_two_sigma"], 0.95);
    for (int k = 0; k < 2; ++k) {
      EXPECT_LT(std::abs(frame["tilt_error_deg"][k].get<double>()),
                4 * frame["sigma_tilt_deg"][k].get<double>());
    }
  }
  const auto people = RunPlumbline("compare " + (folder / "run.h5").string() + " " + sim);
  EXPECT_THAT(people.output, HasSubstr("median"));
}

TEST(Simulate, ARecipeMakesTheSameRecordingAgain) {
  const fs::path folder = testing::TestFolder();
  const std::string first = (folder / "first").string(), second = (folder / "second").string();
  ASSERT_EQ(
      RunPlumbline("simulate nuts -q --frame-count 2 --seed 5 --speed 2 --bits 10 --threads 1 -o " +
                   first)
          .exit_code,
      0);
  ASSERT_EQ(RunPlumbline("simulate -q --recipe " + first + "/recipe.toml --threads 2 -o " + second)
                .exit_code,
            0);
  for (const char* file : {"left/00001.png", "right/00000.png", "channels.csv"}) {
    EXPECT_EQ(TextOf(fs::path(first) / file), TextOf(fs::path(second) / file)) << file;
  }
  EXPECT_TRUE(Validate(fs::path(second) / "truth.h5").empty());
}

TEST(Simulate, WritesVideosThatMeasureReads) {
  const fs::path folder = testing::TestFolder();
  const std::string sim = (folder / "sim").string();
  ASSERT_EQ(RunPlumbline("simulate incline -q --frame-count 2 --images mkv -o " + sim).exit_code,
            0);
  const auto measured =
      RunPlumbline("measure --rig " + sim + "/rig.h5 --left " + sim + "/left.mkv --right " + sim +
                   "/right.mkv --step 8 -o " + (folder / "run.h5").string());
  EXPECT_EQ(measured.exit_code, 0) << measured.output;
  EXPECT_THAT(measured.output, HasSubstr("2 of 2 frames measured"));
}

TEST(Simulate, SaysWhatIsWrong) {
  const fs::path folder = testing::TestFolder();
  const std::string out = " -o " + (folder / "sim").string();
  const auto refused = [&](const std::string& arguments, int code, const std::string& words) {
    const auto result = RunPlumbline(arguments);
    EXPECT_EQ(result.exit_code, code) << arguments << ": " << result.output;
    EXPECT_THAT(result.output, HasSubstr(words)) << arguments;
    EXPECT_FALSE(fs::exists(folder / "sim")) << arguments;
  };
  refused("simulate tyre-squared" + out, 2, "There is no scenario 'tyre-squared'");
  refused("simulate" + out, 2, "scenario is missing");
  refused("simulate still --slip-angle 2" + out, 2, "There is no tyre in the scenario 'still'");
  refused("simulate tyre-flat --bits 7" + out, 2, "--bits takes");
  refused("simulate tyre-flat --drop 77" + out, 2, "Frame 77 cannot be dropped");
  refused("simulate tyre-flat --drop three" + out, 2, "--drop takes numbers");
  refused("simulate tyre-flat --mounting 1,2" + out, 2, "three angles");
  refused("simulate tyre-flat --images avi --bits 12" + out, 2, "Videos hold 8 bits");
  refused("simulate tyre-flat --calibration 3 --board chessboard:9x6:90mm" + out, 3, "too large");
  refused("simulate tyre-flat --exposure 100" + out, 2, "shorter than the time between frames");
  fs::create_directories(folder / "full");
  std::ofstream(folder / "full" / "mine.txt") << "mine";
  refused("simulate still -o " + (folder / "full").string(), 3, "not empty");
  refused("compare " + (folder / "none.h5").string() + " " + folder.string(), 3, "recipe.toml");
}

}  // namespace
}  // namespace plumbline
