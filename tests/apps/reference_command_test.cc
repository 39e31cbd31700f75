// plumbline reference, as a user runs it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "apps/wheel_reference_run.h"
#include "calib/error.h"
#include "io/image_writer.h"
#include "io/rig_file.h"
#include "io/wheel_file.h"
#include "tests/support/plumbline_command.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::CommandResult;
using ::testing::HasSubstr;
using testing::kDegrees;
using testing::LiftedWheel;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr int kFrames = 8;

// Eight frames of the lifted wheel, the fourth one damaged, and the rig.
class ReferenceCommand : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    Scenario scenario = LiftedWheel::ScenarioOf(kFrames, 6 * kDegrees);
    scenario.tags = WheelTagOptions::Parse("36h11:24:24mm");
    wheel_ = new LiftedWheel(scenario);
    for (int f = 0; f < kFrames; ++f) wheel_->Pair(f);
  }
  static void TearDownTestSuite() { delete wheel_; }

  ReferenceCommand() : folder_(TestFolder()) {
    for (const char* side : {"left", "right"}) fs::create_directories(folder_ / side);
    for (int f = 0; f < kFrames; ++f) {
      const std::string name = NameOf(f);
      WritePng(folder_ / "left" / name, wheel_->Pair(f).left);
      WritePng(folder_ / "right" / name, wheel_->Pair(f).right);
    }
    std::ofstream(folder_ / "left" / NameOf(3)) << "damaged";
    WriteRigFile(folder_ / "rig.h5", wheel_->rig());
  }

  static std::string NameOf(int frame) { return "0000" + std::to_string(frame) + ".png"; }
  std::string Path(const std::string& name) const { return (folder_ / name).string(); }
  std::string Arguments(const std::string& more) const {
    return "reference --subset 17 --step 17 --rig " + Path("rig.h5") + " --left " + Path("left") +
           " --right " + Path("right") + " -o " + Path("wheel.h5") + " " + more;
  }

  static LiftedWheel* wheel_;
  fs::path folder_;
};

LiftedWheel* ReferenceCommand::wheel_ = nullptr;

TEST_F(ReferenceCommand, WritesTheWheel) {
  const CommandResult made = RunPlumbline(Arguments("-q --json --fps 5"));
  ASSERT_EQ(made.exit_code, 0) << made.output;
  const auto json = nlohmann::json::parse(made.output);
  EXPECT_EQ(json["placed_frames"], kFrames - 1);
  EXPECT_EQ(json["closed"], false);
  EXPECT_EQ(json["problems"].size(), 1U);
  EXPECT_EQ(json["frames"][3]["status"], "unreadable");
  EXPECT_TRUE(json["frames"][3]["angle_rad"].is_null());
  const WheelReference wheel = ReadWheelFile(Path("wheel.h5"));
  ASSERT_EQ(wheel.frames.size(), static_cast<std::size_t>(kFrames));
  EXPECT_EQ(wheel.frames[3].status, WheelFrameStatus::kUnreadable);
  EXPECT_NEAR(wheel.frames[5].time_s, 1, 1e-9);
  for (int f = 0; f < kFrames; ++f) {
    if (f == 3) continue;
    EXPECT_NEAR(wheel.frames[static_cast<std::size_t>(f)].angle_rad, wheel_->Angle(f),
                0.004 * kDegrees)
        << f;
  }
  const CommandResult told = RunPlumbline("info " + Path("wheel.h5"));
  EXPECT_EQ(told.exit_code, 0);
  EXPECT_THAT(told.output, HasSubstr("the reference of a wheel"));
  EXPECT_THAT(told.output, HasSubstr("no full turn"));
  const CommandResult checked = RunPlumbline("validate " + Path("wheel.h5"));
  EXPECT_EQ(checked.exit_code, 0);
  EXPECT_THAT(checked.output, HasSubstr("is whole: the reference of a wheel"));
  const CommandResult again = RunPlumbline(Arguments("-q"));
  EXPECT_EQ(again.exit_code, 3);
  EXPECT_THAT(again.output, HasSubstr("--overwrite"));
}

TEST_F(ReferenceCommand, TellsWhatTheUserShouldKnow) {
  const CommandResult made = RunPlumbline(Arguments("--tags 36h11 --rim-tags 1,400-401"));
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_THAT(made.output, HasSubstr("Wheel axis: along"));
  EXPECT_THAT(made.output, HasSubstr("00003.png"));
  EXPECT_THAT(made.output, HasSubstr("no full turn closes"));
  EXPECT_THAT(made.output, HasSubstr("calibration unknown"));
  EXPECT_THAT(made.output, HasSubstr("Tags (tag36h11): on the tyre 0"));
  EXPECT_THAT(made.output, HasSubstr("tag 400, said to be on the rim"));
  const WheelTags tags = ReadWheelFile(Path("wheel.h5")).tags;
  EXPECT_EQ(tags.family, "tag36h11");
  ASSERT_GE(tags.tags.size(), 3U);
  for (const WheelTag& tag : tags.tags) {
    EXPECT_EQ(tag.on_rim, tag.id == 1);
    EXPECT_NEAR(tag.SideMm(), 24, 0.3);
    EXPECT_NEAR(std::hypot(tag.Centre().x(), tag.Centre().z()), 381, 1);
  }
  const CommandResult told = RunPlumbline("info --json " + Path("wheel.h5"));
  EXPECT_EQ(nlohmann::json::parse(told.output)["tags"]["found"].size(), tags.tags.size());
}

TEST_F(ReferenceCommand, SaysWhatIsWrong) {
  EXPECT_EQ(RunPlumbline(Arguments("-q --step 9")).exit_code, 2);
  EXPECT_THAT(RunPlumbline(Arguments("-q --tags 36h12")).output, HasSubstr("no family of tags"));
  EXPECT_THAT(RunPlumbline(Arguments("-q --rim-tags 1")).output, HasSubstr("with --tags"));
  for (const char* ids : {"1,a", "3-1", "1-", "-2"}) {
    const CommandResult wrong =
        RunPlumbline(Arguments("-q --tags 36h11 --rim-tags=" + std::string(ids)));
    EXPECT_EQ(wrong.exit_code, 2) << ids;
    EXPECT_THAT(wrong.output, HasSubstr("0,3,7-9")) << ids;
  }
  for (const char* delay : {"late", "0.02,", "0.02,0.001,3", "2", "0.02,-1", "estimate"}) {
    const CommandResult wrong = RunPlumbline(Arguments(std::string("-q --right-delay ") + delay));
    EXPECT_EQ(wrong.exit_code, 2) << delay;
    EXPECT_THAT(wrong.output, HasSubstr("right camera")) << delay;
  }
  const CommandResult sure = RunPlumbline(Arguments("-q --right-delay 0.02,0.001"));
  EXPECT_EQ(sure.exit_code, 2);
  EXPECT_THAT(sure.output, HasSubstr("leave the sigma out"));  // this rig has no modes
  const CommandResult still = RunPlumbline(Arguments("-q --frames 2"));
  EXPECT_EQ(still.exit_code, 3);
  EXPECT_THAT(still.output, HasSubstr("does not turn"));
  const CommandResult swapped =
      RunPlumbline("reference -q --rig " + Path("rig.h5") + " --left " + Path("right") +
                   " --right " + Path("left") + " -o " + Path("w.h5") + " --frames 4:");
  EXPECT_EQ(swapped.exit_code, 3);
  EXPECT_THAT(swapped.output, HasSubstr("left and right are swapped"));
  EXPECT_FALSE(fs::exists(Path("w.h5")));
}

TEST_F(ReferenceCommand, StopsWhenAsked) {
  WheelReferenceRunOptions options;
  options.chain = testing::LiftedWheelOptions();
  int asked = 0;
  const WheelReferenceRun run = MeasureWheelReference(
      wheel_->rig(), [&] { return OpenImageSource(Path("left"), Path("right")); }, options,
      [&](const std::string&, std::int64_t, std::int64_t) { return ++asked < 4; });
  EXPECT_FALSE(run.wheel);
  EXPECT_EQ(asked, 4);
}

}  // namespace
}  // namespace plumbline
