// analyse on runs of a rolling tyre, as a user runs it: what it tells is what measure tells with
// the same settings, to the last bit.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "io/image_writer.h"
#include "io/inspect.h"
#include "io/series_reader.h"
#include "io/series_writer.h"
#include "io/wheel_file.h"
#include "tests/io/series_comparison.h"
#include "tests/support/plumbline_command.h"
#include "tests/track/lifted_wheel.h"
#include "track/wheel_tags.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::CommandResult;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::kDegrees;
using testing::LiftedWheel;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr int kRolling = 3;  // frames; a truncated one follows, and one of another tyre

// With tags on the wheel, and a calibration that may be wrong.
Scenario TyreOf(int frames, double step_rad) {
  Scenario scenario = LiftedWheel::ScenarioOf(frames, step_rad);
  scenario.tags = WheelTagOptions::Parse("36h11:24:24mm");
  StereoRig& rig = scenario.rig;
  rig.modes.modes = Eigen::MatrixXd::Zero(3, rig.ParameterCount());
  rig.modes.modes(0, 0) = 0.05;   // focal length, px
  rig.modes.modes(1, 19) = 3e-5;  // pose, rad
  rig.modes.modes.row(2).tail<3>() = 1e-3 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
  return scenario;
}

Scenario Loaded() {
  Scenario loaded = TyreOf(kRolling, 5 * kDegrees);
  std::get<TyreOptions>(loaded.surface).lifted_mm = 0;
  loaded.seed = 9;
  return loaded;
}

WheelReference TaggedReference() {
  LiftedWheel lifted(TyreOf(5, 6 * kDegrees));
  WheelReference wheel = testing::ReferenceOf(lifted);
  std::vector<TagSighting> sightings;
  for (std::size_t f = 0; f < 5; ++f) {
    const StereoFrame& pair = lifted.Pair(static_cast<int>(f));
    sightings.push_back({f, FindStereoTags(lifted.rig(), pair.left, pair.right, "tag36h11")});
  }
  wheel.tags = MakeWheelTags(wheel, "tag36h11", {}, sightings).tags;
  // As if one of them were on the rim.
  if (!wheel.tags.tags.empty()) wheel.tags.tags[wheel.tags.tags.size() / 2].on_rim = true;
  return wheel;
}

class RollingAnalysis : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new fs::path(fs::path(PLUMBLINE_BINARY_DIR) / "test_output" / "RollingAnalysis");
    fs::remove_all(*folder_);
    for (const char* side : {"left", "right"}) fs::create_directories(*folder_ / side);
    const WheelReference wheel = TaggedReference();
    ASSERT_FALSE(wheel.tags.tags.empty());
    WriteWheelFile(*folder_ / "wheel.h5", wheel);
    const VirtualRig tyre(Loaded());
    Scenario foreign = Loaded();
    foreign.tags.reset();
    ++foreign.speckle.seed;
    const VirtualRig other(foreign);
    for (int f = 0; f < kRolling + 2; ++f) {
      const std::string name = "0" + std::to_string(f) + ".png";
      const VirtualRig& rig = f <= kRolling ? tyre : other;
      WritePng(*folder_ / "left" / name, rig.TakeImage(f % kRolling, Side::kLeft));
      WritePng(*folder_ / "right" / name, rig.TakeImage(f % kRolling, Side::kRight));
    }
    fs::resize_file(*folder_ / "left" / ("0" + std::to_string(kRolling) + ".png"), 5000);
    std::ofstream(*folder_ / "wheel.csv") << "time [s],w [rad/s],v [m/s]\n-1,0.87,0.34\n"
                                             "0.05,0.86,0.35\n0.15,0.88,0.34\n2,0.87,0.34\n";
    Measure("run.h5", kSettings);
  }
  static void TearDownTestSuite() { delete folder_; }

  static std::string Path(const std::string& name) { return (*folder_ / name).string(); }

  static void Measure(const std::string& name, const std::string& settings) {
    const CommandResult made = RunPlumbline(
        "measure -q --reference " + Path("wheel.h5") + " --left " + Path("left") + " --right " +
        Path("right") + " --fps 10 --subset 19 --step 12 -o " + Path(name) + " " + settings);
    ASSERT_EQ(made.exit_code, 0) << made.output;
  }
  static nlohmann::json Analyse(const std::string& from, const std::string& to,
                                const std::string& settings = "") {
    const CommandResult made =
        RunPlumbline("analyse -q --json " + Path(from) + " -o " + Path(to) + " " + settings);
    EXPECT_EQ(made.exit_code, 0) << made.output;
    EXPECT_THAT(Validate(*folder_ / to), IsEmpty());
    return made.exit_code == 0 ? nlohmann::json::parse(made.output) : nlohmann::json();
  }
  static void ExpectRefused(const std::string& from, const std::string& more,
                            const std::string& why) {
    const CommandResult refused =
        RunPlumbline("analyse " + Path(from) + " -o " + Path("refused.h5") + " " + more);
    EXPECT_EQ(refused.exit_code, 3) << refused.output;
    EXPECT_THAT(refused.output, HasSubstr(why));
    EXPECT_FALSE(fs::exists(*folder_ / "refused.h5"));
  }

  // To the last bit.
  static void ExpectSameRuns(const std::string& a, const std::string& b) {
    const SeriesReader one(*folder_ / a), other(*folder_ / b);
    EXPECT_EQ(one.contents(), other.contents());
    EXPECT_EQ(one.grid_px().values(), other.grid_px().values());
    EXPECT_EQ(one.strain_measure(), other.strain_measure());
    EXPECT_EQ(one.strain_axes(), other.strain_axes());
    EXPECT_EQ(one.vsg_px(), other.vsg_px());
    EXPECT_EQ(one.vsg_mm(), other.vsg_mm());
    EXPECT_EQ(one.slip_convention(), other.slip_convention());
    EXPECT_EQ(one.surveyed_frames(), other.surveyed_frames());
    EXPECT_EQ(one.rig().modes.modes, other.rig().modes.modes);
    for (const auto delay : {&SeriesReader::right_delay, &SeriesReader::estimated_right_delay}) {
      ASSERT_EQ((one.*delay)().has_value(), (other.*delay)().has_value());
      if (!(one.*delay)()) continue;
      EXPECT_EQ((one.*delay)()->value_s, (other.*delay)()->value_s);
      EXPECT_EQ((one.*delay)()->sigma_s, (other.*delay)()->sigma_s);
    }
    ASSERT_EQ(one.channels().size(), other.channels().size());
    for (std::size_t k = 0; k < one.channels().size(); ++k) {
      EXPECT_EQ(one.channels()[k].value, other.channels()[k].value);
      testing::ExpectSame(one.channels()[k].clock_offset_s, other.channels()[k].clock_offset_s);
    }
    ASSERT_EQ(one.frame_count(), other.frame_count());
    for (std::int64_t i = 0; i < one.frame_count(); ++i) {
      SCOPED_TRACE("frame " + std::to_string(i) + " of " + a + " and " + b);
      testing::ExpectSameFrame(one.Frame(i), other.Frame(i));
    }
  }

  static constexpr const char* kSettings =
      "--strain-window 5 --strain-order 1 --carcass 20 --carcass-sigma 0.2";
  static fs::path* folder_;
};

fs::path* RollingAnalysis::folder_ = nullptr;

TEST_F(RollingAnalysis, IsTheRunItselfWithItsSettings) {
  const nlohmann::json json = Analyse("run.h5", "same.h5");
  ExpectSameRuns("run.h5", "same.h5");
  const SeriesReader run(*folder_ / "run.h5");
  ASSERT_EQ(run.frame_count(), kRolling + 2);
  for (int f = 0; f < kRolling; ++f) {
    const SeriesFrame frame = run.Frame(f);
    EXPECT_THAT(frame.problem, IsEmpty());
    EXPECT_TRUE(frame.rig_rotation.found && frame.deformation.found);
    EXPECT_TRUE(frame.slip.found) << frame.slip.problem;
    EXPECT_GT(frame.placement.tags, 0);
    EXPECT_FALSE(frame.survey.tags.empty());
  }
  EXPECT_THAT(run.Frame(kRolling).problem, HasSubstr("truncated"));
  EXPECT_THAT(run.Frame(kRolling + 1).problem, HasSubstr("not found on the wheel"));
  EXPECT_THAT(json["notes"].dump(), HasSubstr("2 of 5 frames are not found"));
}

TEST_F(RollingAnalysis, WithOtherSettingsItIsWhatTheseMeasure) {
  const std::string settings =
      "--strain-window 7 --strain-measure hencky --strain-smallest-window 5 --carcass 15 "
      "--contact-threshold 1 --slip-convention sae-j670 --free-rolling-radius 390 "
      "--free-rolling-radius-sigma 0.5 --camber 0,0.1 --wheel-jerk 10 --channels " +
      Path("wheel.csv") + " --channel-offset 0 --wheel-speed w --vehicle-speed v";
  Analyse("run.h5", "other.h5", settings + " --strain-order 2");
  Measure("measured.h5", settings + " --strain-order 2 --carcass-sigma 0.2");
  ExpectSameRuns("measured.h5", "other.h5");
  // What is analysed again stays as it was analysed; what is said changes alone.
  Analyse("other.h5", "again.h5");
  ExpectSameRuns("measured.h5", "again.h5");
  Analyse("again.h5", "back.h5",
          std::string(kSettings) +
              " --strain-measure green_lagrange --strain-smallest-window auto "
              "--contact-threshold 0.5 --slip-convention iso8855 --free-rolling-radius auto "
              "--free-rolling-radius-sigma 0 --camber '' --wheel-jerk auto --wheel-speed '' "
              "--vehicle-speed ''");
  const SeriesReader run(*folder_ / "run.h5"), back(*folder_ / "back.h5");
  for (int f = 0; f < kRolling; ++f) testing::ExpectSameFrame(run.Frame(f), back.Frame(f));
}

TEST_F(RollingAnalysis, KnowsADelayOfTheRightCameraAndAPoseThatIsRefined) {
  const std::string settings = std::string(kSettings) + " --refine-pose always";
  Measure("late.h5", settings + " --right-delay 0.05,0.01");
  Analyse("late.h5", "late_again.h5");
  ExpectSameRuns("late.h5", "late_again.h5");
  EXPECT_TRUE(SeriesReader(*folder_ / "late_again.h5").Frame(0).rig_watch.refined);
  // Flat ground is told by the law of lift-off, which needs the thickness by place.
  Measure("estimated.h5",
          "--strain-window 5 --strain-order 1 --right-delay estimate "
          "--carcass=-79:22,-69:21.4,-59:20.2,0:20,59:20.2,69:21.4,79:22");
  Analyse("estimated.h5", "estimated_again.h5");
  ExpectSameRuns("estimated.h5", "estimated_again.h5");
}

TEST_F(RollingAnalysis, TakesARunOfPartsWhole) {
  for (const char* part : {"1", "2"}) {
    Measure("part" + std::string(part) + ".h5", std::string(kSettings) + " --shard " + part + "/2");
  }
  ExpectRefused("part2.h5", "", "is part 2 of 2 of a run");
  const CommandResult joined = RunPlumbline("merge -q " + Path("part1.h5") + " " +
                                            Path("part2.h5") + " -o " + Path("joined.h5"));
  ASSERT_EQ(joined.exit_code, 0) << joined.output;
  Analyse("joined.h5", "joined_again.h5");
  ExpectSameRuns("run.h5", "joined_again.h5");
}

// As a run that was killed leaves it.
TEST_F(RollingAnalysis, TellsWhatIsThereOfARunByItself) {
  constexpr int kKept = 2;
  {
    const SeriesReader run(*folder_ / "run.h5");
    SeriesHeader header{.rig = run.rig(),
                        .grid_px = run.grid_px(),
                        .step_px = run.step_px(),
                        .subset_px = run.subset_px(),
                        .recipe_toml = run.facts().recipe_toml,
                        .inputs = {*folder_ / "wheel.h5"},
                        .rig_extras = {},
                        .contents = run.contents()};
    header.grid_points = run.grid_points();
    header.displacement_reference = run.displacement_reference();
    header.surveyed_frames = run.surveyed_frames();
    SeriesWriter writer(*folder_ / "killed.h5", header);
    for (int f = 0; f < kKept; ++f) writer.Commit(run.Frame(f));
  }
  EXPECT_EQ(RecoverSeries(*folder_ / "killed.h5").frames, kKept);
  const nlohmann::json json = Analyse("killed.h5", "of_two.h5");
  EXPECT_THAT(json["notes"].dump(), HasSubstr("holds 2 of the 5 frames of its recording"));
  Measure("two.h5", std::string(kSettings) + " --frames 0:2");
  const SeriesReader two(*folder_ / "two.h5"), again(*folder_ / "of_two.h5");
  ASSERT_EQ(two.frame_count(), kKept);
  for (int f = 0; f < kKept; ++f) testing::ExpectSameFrame(two.Frame(f), again.Frame(f));
}

TEST_F(RollingAnalysis, SaysWhatIsMissing) {
  const std::string one_frame = " --frames 0:1 --no-strain";
  Measure("without.h5", one_frame + " --no-matches");
  ExpectRefused("without.h5", "", "--no-matches");
  // A run of before: without /survey.
  {
    const SeriesReader run(*folder_ / "run.h5");
    SeriesHeader header{.rig = run.rig(),
                        .grid_px = run.grid_px(),
                        .recipe_toml = run.facts().recipe_toml,
                        .inputs = {},
                        .rig_extras = {},
                        .contents = run.contents()};
    header.contents.survey = false;
    header.displacement_reference = "wheel";
    SeriesWriter writer(*folder_ / "old.h5", header);
    writer.Commit(run.Frame(0));
    writer.Close();
  }
  ExpectRefused("old.h5", "", "did not keep what the wheel's angle and the ground follow from");
  ExpectRefused("run.h5", "--reference " + Path("run.h5"), "is not the wheel's reference");
  ExpectRefused("run.h5", "--reference " + Path("nowhere.h5"), "There is no file");
  fs::rename(*folder_ / "wheel.h5", *folder_ / "moved.h5");
  ExpectRefused("run.h5", "", "say where it is with --reference");
  Analyse("run.h5", "moved_again.h5", "--reference " + Path("moved.h5"));
  fs::copy_file(*folder_ / "left/00.png", *folder_ / "wheel.h5");
  ExpectRefused("run.h5", "", "is not the file that was read then");
  fs::remove(*folder_ / "wheel.h5");
  fs::rename(*folder_ / "moved.h5", *folder_ / "wheel.h5");
  ExpectSameRuns("run.h5", "moved_again.h5");
}

}  // namespace
}  // namespace plumbline
