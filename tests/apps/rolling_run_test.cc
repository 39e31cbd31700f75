#include "apps/rolling_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "calib/median.h"
#include "io/image_writer.h"
#include "io/inspect.h"
#include "io/rig_file.h"
#include "io/series_reader.h"
#include "io/wheel_file.h"
#include "tests/support/held_pairs.h"
#include "tests/support/plumbline_command.h"
#include "tests/support/true_wheel.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::CommandResult;
using ::testing::HasSubstr;
using testing::HeldPairs;
using ::testing::IsEmpty;
using testing::kDegrees;
using testing::LiftedWheel;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr int kFrames = 2;
constexpr double kFrame_s = 0.1;

Scenario Loaded(unsigned more_seed = 0) {
  Scenario loaded = LiftedWheel::ScenarioOf(kFrames, 5 * kDegrees);
  std::get<TyreOptions>(loaded.surface).lifted_mm = 0;
  loaded.seed = 9;
  loaded.speckle.seed += more_seed;
  return loaded;
}

// The reference of a part of the wheel, and the loaded tyre seen by the same rig; the last pair is
// of another tyre.
class RollingTyre : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    LiftedWheel lifted(6, 6 * kDegrees);
    reference_ = new WheelReference(testing::ReferenceOf(lifted));
    tyre_ = new VirtualRig(Loaded());
    pairs_ = new std::vector<StereoFrame>;
    for (int f = 0; f < kFrames; ++f) pairs_->push_back(PairOf(*tyre_, f, f));
    pairs_->push_back(PairOf(VirtualRig(Loaded(1)), 1, kFrames));
    run_ = new RollingRun(*reference_, Options());
    HeldPairs recording(*pairs_);
    ASSERT_TRUE(run_->Survey(recording, [](std::int64_t, std::int64_t) { return true; }));
    frames_ = new std::vector<SeriesFrame>;
    for (std::size_t f = 0; f < pairs_->size(); ++f) {
      frames_->push_back(run_->Measure((*pairs_)[f], static_cast<std::int64_t>(f)).frame);
    }
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete tyre_;
    delete pairs_;
    delete run_;
    delete frames_;
  }

  static StereoFrame PairOf(const VirtualRig& rig, int frame, int index) {
    StereoFrame pair;
    pair.index = index;
    pair.time_s = index * kFrame_s;
    pair.left_id = "left_" + std::to_string(index);
    pair.right_id = "right_" + std::to_string(index);
    pair.left = rig.TakeImage(frame, Side::kLeft);
    pair.right = rig.TakeImage(frame, Side::kRight);
    return pair;
  }
  static RollingRunOptions Options() {
    RollingRunOptions options;
    options.sequence.field.correlator.subset_px = 19;
    options.sequence.field.correlator.order = 2;
    options.sequence.field.step_px = 6;
    options.survey.matching = options.sequence;
    options.evaluation.strain_options.window_points = 5;
    return options;
  }
  // Places of the points now, on the undeformed wheel at the same angle.
  static Eigen::Vector3d UndeformedAt(const SeriesFrame& frame, std::size_t i) {
    return (frame.surface.position_mm.data()[i] - frame.displacement.value_mm.data()[i])
        .cast<double>();
  }

  static WheelReference* reference_;
  static VirtualRig* tyre_;
  static std::vector<StereoFrame>* pairs_;
  static RollingRun* run_;
  static std::vector<SeriesFrame>* frames_;  // measured
};

WheelReference* RollingTyre::reference_ = nullptr;
VirtualRig* RollingTyre::tyre_ = nullptr;
std::vector<StereoFrame>* RollingTyre::pairs_ = nullptr;
RollingRun* RollingTyre::run_ = nullptr;
std::vector<SeriesFrame>* RollingTyre::frames_ = nullptr;

TEST_F(RollingTyre, IsMeasuredAgainstTheUndeformedWheel) {
  EXPECT_EQ(run_->wheel().placed(), kFrames);
  const SeriesHeader header = run_->Header();
  EXPECT_EQ(header.displacement_reference, "wheel");
  EXPECT_TRUE(header.contents.wheel && header.contents.material && !header.contents.velocity);
  for (int f = 0; f < kFrames; ++f) {
    const SeriesFrame& frame = (*frames_)[static_cast<std::size_t>(f)];
    ASSERT_THAT(frame.problem, IsEmpty());
    const auto truth = tyre_->Truth(f);
    const Rigid3 ground_from_rig = truth->ground_from_rig();
    std::vector<double> radial, across, z2, strain[3];
    for (int r = 0; r < header.grid_px.height(); ++r) {
      for (int c = 0; c < header.grid_px.width(); ++c) {
        const std::size_t i = static_cast<std::size_t>(r * header.grid_px.width() + c);
        const Eigen::Vector3f& moved = frame.displacement.value_mm.data()[i];
        if (!moved.allFinite()) continue;
        const auto there = truth->UnderLeftPixel(
            (header.grid_px(r, c) + frame.match.left_displacement_px(r, c)).cast<double>());
        ASSERT_TRUE(there.has_value());
        const Eigen::Vector3d off =
            moved.cast<double>() - ground_from_rig.rotation.transpose() * there->displacement_mm;
        // Towards the axis, which the wheel's angle has no part in.
        const Eigen::Vector3d axis = frame.wheel.axis;
        Eigen::Vector3d outwards = UndeformedAt(frame, i) - frame.wheel.centre_mm;
        outwards = (outwards - axis * axis.dot(outwards)).normalized();
        const Eigen::Vector3f sigma = frame.displacement.sigma_random_mm.data()[i];
        radial.push_back(std::abs(off.dot(outwards)));
        across.push_back(std::abs(off.dot(axis)));
        const double along_z = off.z() / static_cast<double>(sigma.z());
        z2.push_back(along_z * along_z);
        const Eigen::Vector3f& e = frame.strain.value.data()[i];
        if (!e.allFinite()) continue;
        for (int k = 0; k < 3; ++k) {
          strain[k].push_back(std::abs(static_cast<double>(e[k]) - there->green_lagrange[k]));
        }
      }
    }
    ASSERT_GT(radial.size(), 500U);
    EXPECT_LT(Median(radial), 0.04) << f;
    EXPECT_LT(Median(across), 0.015) << f;
    // Chi-squared of one freedom has its median at 0.455.
    EXPECT_LT(Median(z2), 1.0) << f;
    EXPECT_GT(Median(z2), 0.1) << f;
    ASSERT_GT(strain[0].size(), 300U);
    for (int k = 0; k < 3; ++k) EXPECT_LT(Median(strain[k]), 1.5e-3) << f << " " << k;
    EXPECT_TRUE(frame.wheel.found);
    EXPECT_NEAR(frame.wheel.speed_rad_s, 5 * kDegrees / kFrame_s, 0.01);
    EXPECT_LT(frame.wheel.sigma_random_angle_rad, 0.005 * kDegrees);
  }
  const SeriesFrame& foreign = frames_->back();
  EXPECT_THAT(foreign.problem, HasSubstr("not found on the wheel: "));
  EXPECT_FALSE(foreign.wheel.found);
  EXPECT_TRUE(foreign.surface.status.empty());
  EXPECT_THAT(run_->Notes().front(), HasSubstr("1 of 3 frames"));
}

// Material points stay what they are while the wheel turns.
TEST_F(RollingTyre, FollowsTheMaterial) {
  const SeriesFrame &first = (*frames_)[0], &second = (*frames_)[1];
  ASSERT_EQ(run_->wheel().frames[0].view, run_->wheel().frames[1].view);
  const Rigid3 rig_from_wheel = reference_->axis.RigFromWheel(second.wheel.angle_rad);
  int both = 0;
  for (std::size_t i = 0; i < first.material.position_mm.pixel_count(); ++i) {
    const Eigen::Vector3f &before = first.material.position_mm.data()[i],
                          &now = second.material.position_mm.data()[i];
    if (!before.allFinite() || !now.allFinite()) continue;
    ++both;
    EXPECT_LT((before - now).norm(), 1e-3F);
    EXPECT_LT((rig_from_wheel * now.cast<double>() - UndeformedAt(second, i)).norm(), 1e-3);
  }
  EXPECT_GT(both, 100);
}

TEST_F(RollingTyre, IsToldInTheFrameOfTheGroundUnderIt) {
  RollingRun run(*reference_, Options());
  HeldPairs recording(*pairs_);
  ASSERT_TRUE(run.Survey(recording, [](std::int64_t, std::int64_t) { return true; }));
  RollingContactOptions contact;
  contact.carcass.thickness_mm = {20};
  contact.slip.convention = SlipConvention::kSaeJ670;
  run.FindContact(contact);
  const SeriesHeader header = run.Header();
  EXPECT_TRUE(header.contents.patch && header.contents.slip && header.contents.deformation);
  EXPECT_EQ(header.slip_convention, "SAE J670");
  const SeriesFrame frame = run.Measure((*pairs_)[0], 0).frame;
  ASSERT_THAT(frame.problem, IsEmpty());
  EXPECT_EQ(frame.surface.frame, SurfaceFrame::kGround);
  const auto truth = tyre_->Truth(0);
  std::vector<double> height, risen;
  for (int r = 0; r < header.grid_px.height(); ++r) {
    for (int c = 0; c < header.grid_px.width(); ++c) {
      if (frame.surface.status(r, c) != Status::kOk) continue;
      const auto there = truth->UnderLeftPixel(
          (header.grid_px(r, c) + frame.match.left_displacement_px(r, c)).cast<double>());
      ASSERT_TRUE(there.has_value());
      height.push_back(std::abs(static_cast<double>(frame.surface.position_mm(r, c).z()) -
                                there->position_mm.z()));
      risen.push_back(std::abs(static_cast<double>(frame.displacement.value_mm(r, c).z()) -
                               there->displacement_mm.z()));
      EXPECT_GT(frame.surface.sigma_random_mm(r, c).z(), 0);
    }
  }
  ASSERT_GT(height.size(), 500U);
  EXPECT_LT(Median(height), 0.06);
  EXPECT_LT(Median(risen), 0.05);
  EXPECT_LT(frame.wheel.axis.cross(Eigen::Vector3d::UnitY()).norm(), 0.05 * kDegrees);
  EXPECT_NEAR(frame.wheel.centre_mm.z(), 386, 0.1);
  EXPECT_NEAR(frame.wheel.centre_mm.x(), 0, 0.2);
  const Eigen::Vector3d normal = truth->ground_from_rig().rotation.row(2);
  EXPECT_LT((frame.ground.normal_in_rig - normal).norm(), 0.05 * kDegrees);
  EXPECT_TRUE(frame.rig_rotation.found);
  EXPECT_NEAR(frame.deformation.loaded_radius_mm, 386, 0.1);
  EXPECT_NEAR(frame.deformation.deflection_mm, 18, 0.3);
  ASSERT_TRUE(frame.slip.found) << frame.slip.problem;
  EXPECT_TRUE(std::isnan(frame.slip.ratio));  // nobody told the radius of free rolling
  const double speed = std::get<TyreOptions>(tyre_->scenario().surface).speed_mm_s;
  const double stretched = tyre_->scenario().frames_per_second * kFrame_s;  // the clock of the test
  EXPECT_NEAR(frame.slip.speed_mm_s * stretched / speed, 1, 0.02);
  // Another tyre's frame has none of it, and says why; the rig's rotation is that of the others.
  const SeriesFrame foreign = run.Measure(pairs_->back(), kFrames).frame;
  EXPECT_FALSE(foreign.patch.found || foreign.slip.found || foreign.deformation.found);
  EXPECT_EQ(foreign.rig_rotation.lean, 1);
  EXPECT_THAT(foreign.patch.problem, ::testing::Not(IsEmpty()));
}

TEST_F(RollingTyre, TurnsAsItDoesUnderARigThatSwings) {
  Scenario scenario = LiftedWheel::ScenarioOf(4, 5 * kDegrees);
  auto& tyre = std::get<TyreOptions>(scenario.surface);
  tyre.lifted_mm = 0;
  tyre.speed_swing_mm_s = 400;
  scenario.motion.flexure_rad_per_m_s2 = 1.5 * kDegrees;
  LiftedWheel swinging(scenario);
  std::vector<StereoFrame> pairs;
  for (int f = 0; f < swinging.frames(); ++f) {
    pairs.push_back(PairOf(swinging.virtual_rig(), f, f));
    pairs.back().time_s = swinging.virtual_rig().FrameTime(f);
  }
  RollingRun run(*reference_, Options());
  HeldPairs recording(pairs);
  ASSERT_TRUE(run.Survey(recording, [](std::int64_t, std::int64_t) { return true; }));
  // Of the last turn over the ground since the first frame.
  const auto off = [&] {
    const auto pitch = [&](std::size_t f) {
      const Eigen::Vector3d normal =
          reference_->axis.rotation.transpose() *
          swinging.virtual_rig().GroundFromRig(pairs[f].time_s).rotation.row(2).transpose();
      return std::atan2(normal.x(), normal.z());
    };
    const double turn = run.wheel().frames[3].angle_rad - run.wheel().frames[0].angle_rad;
    return std::abs(turn - (pitch(3) - pitch(0)) - swinging.Angle(3));
  };
  EXPECT_GT(off(), 0.05 * kDegrees);
  RollingContactOptions contact;
  contact.carcass = testing::TrueCarcass(swinging.virtual_rig(), reference_->axis, 5);
  run.FindContact(contact);
  EXPECT_LT(off(), 0.01 * kDegrees);
}

TEST_F(RollingTyre, SaysWhyNothingIsOnTheWheel) {
  RollingRun run(*reference_, Options());
  HeldPairs recording({pairs_->back()});
  try {
    (void)run.Survey(recording, [](std::int64_t, std::int64_t) { return true; });
    FAIL() << "another tyre was taken for the wheel's";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("None of the 1 frames is found on the wheel"));
  }
  RollingRun stopped(*reference_, Options());
  HeldPairs again({pairs_->back()});
  EXPECT_FALSE(stopped.Survey(again, [](std::int64_t done, std::int64_t) { return done < 1; }));
  RollingRunOptions options = Options();
  options.sequence.strategy = StereoStrategy::kIncremental;
  EXPECT_THROW(RollingRun(*reference_, options), UsageError);
  RollingRunOptions beside = Options();
  ++beside.survey.matching.field.step_px;
  EXPECT_THROW(RollingRun(*reference_, beside), UsageError);
}

TEST_F(RollingTyre, IsMeasuredByTheCommand) {
  const fs::path folder = TestFolder();
  for (const char* side : {"left", "right"}) fs::create_directories(folder / side);
  for (const int f : {0, kFrames}) {
    const StereoFrame& pair = (*pairs_)[static_cast<std::size_t>(f)];
    WritePng(folder / "left" / ("0" + std::to_string(f) + ".png"), pair.left);
    WritePng(folder / "right" / ("0" + std::to_string(f) + ".png"), pair.right);
  }
  WriteWheelFile(folder / "wheel.h5", *reference_);
  WriteRigFile(folder / "rig.h5", reference_->rig);
  const auto path = [&](const std::string& name) { return (folder / name).string(); };
  std::ofstream(folder / "channels.csv") << "time [s],w [rad/s]\n0,3\n1,3.1\n";
  const std::string images = " --left " + path("left") + " --right " + path("right") +
                             " --subset 19 --step 12 -q -o " + path("run.h5");
  const CommandResult made =
      RunPlumbline("measure --json --fps 10 --reference " + path("wheel.h5") + " --channels " +
                   path("channels.csv") + " --channel-offset 0 --wheel-speed w" + images);
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_THAT(Validate(folder / "run.h5"), IsEmpty());
  const SeriesReader run(folder / "run.h5");
  ASSERT_EQ(run.frame_count(), 2);
  EXPECT_EQ(run.displacement_reference(), "wheel");
  EXPECT_TRUE(run.Frame(0).wheel.found);
  EXPECT_FALSE(run.Frame(0).material.position_mm.empty());
  EXPECT_EQ(run.Frame(0).placement.placed_by, 3);  // by its features
  EXPECT_EQ(run.Frame(0).placement.tags, 0);
  EXPECT_THAT(run.Frame(1).problem, HasSubstr("not found on the wheel"));
  EXPECT_FALSE(run.Frame(1).placement.found);
  EXPECT_FALSE(run.Frame(1).wheel.found);
  // One frame does not turn; the channel is not used, and file and report say so.
  EXPECT_FALSE(run.Frame(0).wheel_channel.found);
  EXPECT_THAT(run.Frame(0).wheel_channel.problem, HasSubstr("no two frames"));
  EXPECT_THAT(made.output, HasSubstr("does not lean on the channel"));

  const auto refused = [&](const std::string& arguments, int code, const std::string& text) {
    const CommandResult result = RunPlumbline("measure --overwrite " + arguments + images);
    EXPECT_EQ(result.exit_code, code) << arguments;
    EXPECT_THAT(result.output, HasSubstr(text)) << arguments;
  };
  refused("", 2, "--rig");
  refused("--rig " + path("rig.h5") + " --reference " + path("wheel.h5"), 2, "leave out --rig");
  refused("--matcher sgbm --reference " + path("wheel.h5"), 2, "not sgbm");
  refused("--reference-frame 0 --reference " + path("wheel.h5"), 2, "--reference-frame");
  const std::string wheel = "--reference " + path("wheel.h5");
  refused(wheel + " --carcass 20,20", 2, "thickness in mm");
  refused(wheel + " --right-delay 0.02ms", 2, "estimate");
  refused(wheel + " --right-delay 0.02", 3, "--fps");
  refused("--rig " + path("rig.h5") + " --right-delay 0.02", 2, "rolling tyre");
  refused(wheel + " --carcass=10:20,-10:20", 2, "ascend");
  refused(wheel + " --ground-turns 157", 2, "three angles");
  refused(wheel + " --obstacle-height 0", 2, "above 0");
  refused(wheel + " --obstacle-height 38,0.1,2", 2, "above 0");
  refused(wheel + " --camber 1", 2, "standard deviation");
  refused(wheel + " --fps 10 --vehicle-speed v", 2, "no channel 'v'");
  refused(wheel + " --fps 10 --wheel-speed v", 2, "no channel 'v'");
  refused(wheel + " --wheel-speed-sigma 0.1", 2, "give --wheel-speed");
  refused(wheel + " --channel-offset-sigma 0.1", 2, "of --channel-offset");
  refused("--reference " + path("rig.h5"), 3, "rig.h5");
  refused("--reference " + path("none.h5"), 3, "none.h5");
}

}  // namespace
}  // namespace plumbline
