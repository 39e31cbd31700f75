// plumbline noise and plumbline speckle, as a user runs them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "io/image_writer.h"
#include "io/noise_file.h"
#include "tests/support/plumbline_command.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

using testing::CommandResult;
using ::testing::HasSubstr;
using testing::RunPlumbline;
using testing::TestFolder;

GrayImage Photograph(double noise, std::uint32_t seed, double shift_px = 0) {
  return testing::RenderSpeckle(
      {220, 180},
      [&](const Eigen::Vector2d& p) { return Eigen::Vector2d(p.x() + shift_px, p.y()); }, noise,
      seed);
}

// cam0_0.png and so on, each moved by step_px against the last.
fs::path StillFrames(double noise, double step_px = 0) {
  const fs::path folder = TestFolder();
  for (std::uint32_t i = 0; i < 4; ++i) {
    WritePng(folder / ("cam0_" + std::to_string(i) + ".png"), Photograph(noise, i, i * step_px));
  }
  return folder;
}

TEST(NoiseCommand, FindsTheNoiseAndWritesItsFile) {
  const fs::path f = StillFrames(1.5);
  const std::string output = (f / "noise.toml").string();
  const std::string call = "noise --images '" + (f / "cam0_*.png").string() + "' -o " + output;
  const CommandResult words = RunPlumbline(call + " -q 2>&1");
  ASSERT_EQ(words.exit_code, 0) << words.output;
  const CameraNoise noise = ReadCameraNoise(output, "camera");
  EXPECT_NEAR(std::sqrt(noise.model.Variance(120)), 1.5, 0.03);
  EXPECT_EQ(noise.frames, 4);
  EXPECT_EQ(noise.size, (ImageSize{220, 180}));

  const CommandResult json = RunPlumbline(call + " --json -q 2>/dev/null");
  const auto found = nlohmann::json::parse(json.output);
  EXPECT_EQ(found["pairs"], 3);
  EXPECT_EQ(found["slope_grey"], noise.model.slope_grey);
  EXPECT_FALSE(found["curve"].empty());
}

TEST(NoiseCommand, KeepsTheOtherCamera) {
  const fs::path f = StillFrames(1.5);
  const std::string rest =
      " --images " + f.string() + " -q -o " + (f / "rig.toml").string() + " --camera ";
  EXPECT_EQ(RunPlumbline("noise" + rest + "left").exit_code, 0);
  EXPECT_EQ(RunPlumbline("noise" + rest + "right").exit_code, 0);
  EXPECT_EQ(ReadNoiseFile(f / "rig.toml").cameras.size(), 2u);
}

TEST(NoiseCommand, LeavesADamagedFrameOutAndNamesIt) {
  const fs::path f = StillFrames(1.5);
  fs::resize_file(f / "cam0_2.png", fs::file_size(f / "cam0_2.png") / 2);
  const CommandResult result =
      RunPlumbline("noise --images " + f.string() + " -o " + (f / "noise.toml").string());
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_THAT(result.output, HasSubstr("cam0_2.png"));
  EXPECT_THAT(result.output, HasSubstr("3 still frames of 220x180 px"));
}

TEST(NoiseCommand, RefusesWhatTellsNothing) {
  const fs::path f = StillFrames(1, 1.0);
  const std::string moved =
      RunPlumbline("noise -q --images " + f.string() + " -o " + (f / "n.toml").string()).output;
  EXPECT_THAT(moved, HasSubstr("The picture moved by at least"));
  EXPECT_FALSE(fs::exists(f / "n.toml"));
  const CommandResult one = RunPlumbline("noise -q --images " + (f / "cam0_1.png").string());
  EXPECT_EQ(one.exit_code, 3);
  EXPECT_THAT(one.output, HasSubstr("there is only 1"));
  EXPECT_EQ(RunPlumbline("noise --images nowhere").exit_code, 3);
  EXPECT_EQ(RunPlumbline("noise --images x --max-motion 2").exit_code, 2);
}

TEST(SpeckleCommand, PredictsWithTheNoiseItIsGiven) {
  const fs::path f = TestFolder();
  const std::string image = (f / "reference.png").string();
  WritePng(image, Photograph(1, 1));
  CameraNoise noise;
  noise.model = {4, 0};
  WriteNoiseFile(f / "noise.toml", {{{"camera", noise}}, {}});
  const auto sigma = [&](const std::string& options) {
    const CommandResult result = RunPlumbline("speckle " + image + " --json -q " + options);
    return nlohmann::json::parse(result.output)["median_sigma_px"].get<double>();
  };
  const double own = sigma("");
  EXPECT_NEAR(sigma("--noise " + (f / "noise.toml").string()) / own, 1.95, 0.15);
  EXPECT_NEAR(own / sigma("--subset 65"), 2, 0.2);
  const std::string words = RunPlumbline("speckle " + image).output;
  EXPECT_THAT(words, HasSubstr("Feature size"));
  EXPECT_THAT(words, HasSubstr("estimated from this image"));
  EXPECT_THAT(words, HasSubstr("Nothing to complain about."));
}

TEST(SpeckleCommand, RefusesWhatCannotBeLookedAt) {
  const fs::path f = TestFolder();
  const std::string image = (f / "i.png").string();
  WritePng(image, GrayImage{Image<std::uint16_t>({60, 60}, 255), 8});
  const std::string mask = (f / "m.png").string();
  WritePng(mask, GrayImage{Image<std::uint16_t>({60, 60}, 0), 8});
  const auto complaint = [&](const std::string& options) {
    const CommandResult result = RunPlumbline("speckle " + image + options);
    EXPECT_NE(result.exit_code, 0);
    return result.output;
  };
  EXPECT_THAT(complaint(""), HasSubstr("which is white"));
  EXPECT_THAT(complaint(" --mask " + mask), HasSubstr("0 everywhere"));
  EXPECT_THAT(complaint(" --subset 61"), HasSubstr("smaller than the subset"));
  EXPECT_THAT(complaint(" --noise none.toml"), HasSubstr("There is no noise file"));
  WritePng(image, testing::RenderSpeckle({60, 60}, [](const auto& p) { return p; }, 2, 1,
                                         {.contrast = 0}));
  const CommandResult blank = RunPlumbline("speckle " + image);
  EXPECT_EQ(blank.exit_code, 3);
  EXPECT_THAT(blank.output, HasSubstr("no texture above the noise"));
}

}  // namespace
}  // namespace plumbline
