#include "track/rolling_contact.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "calib/triangulate.h"
#include "io/virtual_rig/tyre_patch.h"
#include "tests/support/true_wheel.h"
#include "tests/track/lifted_wheel.h"
#include "track/carcass_modes.h"
#include "track/internal/finite_differences.h"
#include "track/internal/turning_over_ground.h"
#include "track/right_flow.h"

namespace plumbline {
namespace {

using testing::kDegrees;
using testing::LiftedWheel;

constexpr int kSubset = 17;

// The braked tyre, seen by the rig that made the reference of a part of it.
class RollingContactOfAnArc : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    LiftedWheel lifted(6, 6 * kDegrees);
    reference_ = new WheelReference(testing::ReferenceOf(lifted));
    rolling_ = new LiftedWheel(Braked());
    RollingSurveyOptions options;
    options.matching.field.step_px = 6;
    options.matching.field.correlator.subset_px = kSubset;
    RollingSurvey survey(*reference_, options);
    for (int f = 0; f < rolling_->frames(); ++f) {
      (void)survey.Add(f, rolling_->virtual_rig().FrameTime(f), rolling_->Pair(f).left,
                       rolling_->Pair(f).right);
    }
    survey_ = new RollingWheel(survey.Finish());
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete rolling_;
    delete survey_;
  }

  static Scenario Braked() {
    Scenario scenario = LiftedWheel::ScenarioOf(7, 4 * kDegrees);
    auto& tyre = std::get<TyreOptions>(scenario.surface);
    tyre.lifted_mm = 0;
    tyre.slip_ratio = -0.03;
    scenario.seed = 9;
    return scenario;
  }
  static RollingContactOptions Options() {
    RollingContactOptions options;
    options.carcass = testing::TrueCarcass(rolling_->virtual_rig(), reference_->axis, 5);
    options.subset_px = kSubset;
    return options;
  }

  static WheelReference* reference_;
  static LiftedWheel* rolling_;
  static RollingWheel* survey_;
};

WheelReference* RollingContactOfAnArc::reference_ = nullptr;
LiftedWheel* RollingContactOfAnArc::rolling_ = nullptr;
RollingWheel* RollingContactOfAnArc::survey_ = nullptr;

TEST_F(RollingContactOfAnArc, TellsGroundDeformationPatchAndSlipOfEveryFrame) {
  RollingContactOptions options = Options();
  MeasuredScalar free_rolling;
  free_rolling.value = 389;
  free_rolling.sigma_random = 0.1;
  options.free_rolling_radius_mm = free_rolling;
  const RollingContact contact = FindRollingContact(*reference_, *survey_, options);
  ASSERT_TRUE(contact.found) << contact.problem;
  ASSERT_EQ(contact.frames.size(), 7U);
  for (int f = 0; f < 7; ++f) {
    const RollingContactFrame& frame = contact.frames[static_cast<std::size_t>(f)];
    const VirtualRig& truth = rolling_->virtual_rig();
    const double time = truth.FrameTime(f);
    const WheelState wheel = rolling_->Wheel(f);
    ASSERT_TRUE(frame.rotation.found) << frame.rotation.problem;
    const Eigen::Vector3d normal = frame.rotation.ground.frame_from_rig.rotation.row(2);
    const Eigen::Vector3d true_normal = truth.GroundFromRig(time).rotation.row(2);
    EXPECT_LT(std::acos(std::min(1.0, normal.dot(true_normal))), 0.04 * kDegrees) << f;
    const WheelDeformation& deformation = frame.deformation;
    EXPECT_NEAR(deformation.loaded_radius_mm.value, wheel.centre_height_mm, 0.3);
    EXPECT_NEAR(deformation.deflection_mm.value, 18, 0.3) << deformation.problem;
    const auto patch = FindPatch(*rolling_->virtual_rig().tyre(), time);
    ASSERT_TRUE(patch);
    EXPECT_EQ(frame.patch.by, FramePatch::By::kLiftOff) << frame.patch.problem;
    // A subset here is 15 mm wide, as is the rounding where the tyre lifts off: that ends early.
    EXPECT_NEAR(frame.patch.patch.area_mm2 / patch->area_mm2, 0.9, 0.12);
    ASSERT_TRUE(frame.slip.found) << frame.slip.problem;
    // At the ends the rate at which the ground turns in the rig is of three poses.
    const bool end = f == 0 || f == 6;
    EXPECT_NEAR(frame.slip.speed_mm_s.value / wheel.speed_mm_s, 1, end ? 0.005 : 0.004) << f;
    EXPECT_NEAR(frame.slip.slip_angle_rad.value, 0, 0.2 * kDegrees);
    EXPECT_NEAR(frame.slip.ratio.value, -0.03, 0.003);
    EXPECT_GT(frame.slip.sticking, 20);
  }
}

TEST_F(RollingContactOfAnArc, TheEndsOfARecordingHaveTheSpeedOfTheirOwnMoment) {
  // As if the wheel had been slower in the first frame by a tenth: half-way to the second one it
  // went as the material says.
  RollingWheel slower = *survey_;
  const RollingContact even = FindRollingContact(*reference_, *survey_, Options());
  const double omega = slower.frames[1].speed_rad_s;
  slower.frames[0].speed_rad_s = 0.9 * omega;
  const RollingContact found = FindRollingContact(*reference_, slower, Options());
  const RollingSlip &then = even.frames[0].slip, &now = found.frames[0].slip;
  ASSERT_TRUE(now.found);
  EXPECT_NEAR(now.speed_mm_s.value, then.speed_mm_s.value * 0.9 / 0.95,
              1e-3 * then.speed_mm_s.value);
  EXPECT_NEAR(now.effective_radius_mm.value, then.effective_radius_mm.value / 0.95,
              1e-3 * then.effective_radius_mm.value);
  EXPECT_EQ(found.frames[2].slip.speed_mm_s.value, even.frames[2].slip.speed_mm_s.value);
  // An arm that swings turns the ground in the rig, not the wheel over the ground.
  std::vector<RigRotationFrame> poses(3);
  std::vector<double> times_s;
  for (std::size_t k = 0; k < 3; ++k) {
    poses[k].pose[0] = 0.2 * survey_->frames[1 + k].time_s;
    times_s.push_back(survey_->frames[1 + k].time_s);
  }
  const std::vector<double> weights = internal::SlopeWeights(times_s, 1);
  const MeasuredScalar turning = internal::TurningOverGround(*survey_, 1, 2, poses, weights);
  EXPECT_NEAR(turning.value, survey_->frames[2].speed_rad_s - 0.2, 1e-3);
}

TEST_F(RollingContactOfAnArc, CountsWhatAParabolaLeavesOutOfASpeedThatChanges) {
  const RollingContact even = FindRollingContact(*reference_, *survey_, Options());
  // The same way in other times: the speed in the middle is less than that of the frames beside.
  RollingWheel uneven = *survey_;
  const double step_s = uneven.frames[1].time_s - uneven.frames[0].time_s;
  for (RollingFrame& frame : uneven.frames) {
    const double since_middle = frame.time_s - survey_->frames[3].time_s;
    frame.time_s += since_middle * (1 - std::pow(since_middle / (8 * step_s), 2));
  }
  const RollingContact found = FindRollingContact(*reference_, uneven, Options());
  const auto speed = [&](std::size_t f) { return found.frames[f].slip.speed_mm_s; };
  ASSERT_GT(speed(2).value, 1.01 * speed(3).value);
  const double left_out = (speed(2).value + speed(4).value - 2 * speed(3).value) / 6;
  EXPECT_GT(speed(3).sigma_random, 0.99 * left_out);
  EXPECT_LT(speed(3).sigma_random, left_out + 1.5 * even.frames[3].slip.speed_mm_s.sigma_random);
  // The truth: half of the even speed in the middle.
  const double off = speed(3).value - rolling_->Wheel(3).speed_mm_s / 2;
  EXPECT_GT(std::abs(off), 0.3 * left_out);
  EXPECT_LT(std::abs(off), 2 * speed(3).sigma_random);
}

// A wheel that is seen to drift to the side more and more: from the last frame's one neighbour
// alone half a step of that is missed.
TEST_F(RollingContactOfAnArc, CountsAtTheEndsByHowMuchTheSlipAngleChanges) {
  const RollingContact even = FindRollingContact(*reference_, *survey_, Options());
  RollingWheel drifting = *survey_;
  const Eigen::Vector3d axis = reference_->axis.direction_in_rig();
  for (std::size_t f = 0; f < drifting.frames.size(); ++f) {
    for (RollingPoint& p : drifting.frames[f].points) {
      p.point_mm += 0.02 * static_cast<double>(f * f) * axis;
    }
  }
  const RollingContact found = FindRollingContact(*reference_, drifting, Options());
  const auto change = [&](std::size_t f) {
    return found.frames[f].slip.slip_angle_rad.value - even.frames[f].slip.slip_angle_rad.value;
  };
  const MeasuredScalar &last = found.frames[6].slip.slip_angle_rad,
                       &before = found.frames[5].slip.slip_angle_rad;
  ASSERT_GT(std::abs(change(6) - change(5)), 5e-4);
  EXPECT_GE(last.sigma_random, 0.999 * std::abs(last.value - before.value));
  EXPECT_LT(before.sigma_random, 0.5 * last.sigma_random);
  // The slope at the last frame is as much above the line's as that is above the slope before it.
  const double missed = change(6) - change(5);
  EXPECT_NEAR(change(5) - change(4), 2 * missed, 0.2 * std::abs(missed));
}

TEST(GroundPitches, AreNoneOfARigThatStandsStillAndOfTheNearestFrameWhereNotKnown) {
  RollingContact contact;
  EXPECT_TRUE(GroundPitchesOf(contact).empty());
  contact.frames.resize(5);
  for (std::size_t f = 0; f < 5; ++f) {
    RigRotationFrame& rotation = contact.frames[f].rotation;
    rotation.found = f != 0 && f != 3;
    rotation.known.fill(rotation.found);
    rotation.pose[0] = 0.1;
    rotation.cov_random(0, 0) = 1e-8;
  }
  EXPECT_TRUE(GroundPitchesOf(contact).empty());
  contact.frames[2].rotation.pose[0] = 0.11;
  contact.frames[4].rotation.pose[0] = 0.14;
  const std::vector<GroundPitch> pitch = GroundPitchesOf(contact);
  ASSERT_EQ(pitch.size(), 5U);
  EXPECT_EQ(pitch[0].value_rad, 0.1);
  EXPECT_NEAR(pitch[0].sigma_rad, 0.04, 1e-12);
  EXPECT_NEAR(pitch[1].sigma_rad, 1e-4, 1e-12);
  EXPECT_EQ(pitch[3].value_rad, 0.14);
  EXPECT_NEAR(pitch[3].sigma_rad, 0.04, 1e-12);
  EXPECT_EQ(pitch[4].value_rad, 0.14);
}

TEST_F(RollingContactOfAnArc, StandsAsTheUserSays) {
  RollingContactOptions options = Options();
  options.manual_turns_deg = Eigen::Vector3d(180, 0, 0);
  const RollingContact contact = FindRollingContact(*reference_, *survey_, options);
  ASSERT_TRUE(contact.found);
  for (const RollingContactFrame& frame : contact.frames) {
    EXPECT_NEAR(frame.rotation.ground.frame_from_rig.rotation(2, 2), -1, 1e-12);
    EXPECT_EQ(frame.rotation.lean, 0);
  }
}

// What contact is found where the thickness of the carcass has a sigma, and where each entry is
// off.
struct OffByThickness {
  RollingContact found, off;
};
OffByThickness WithErrors(const WheelReference& reference, const RollingWheel& measured,
                          RollingContactOptions options, const std::vector<double>& errors_mm) {
  CarcassThickness& carcass = options.carcass;
  carcass.sigma_mm = 0.1;
  EXPECT_THROW((void)WithCarcassModes(reference, carcass), UsageError);
  const auto modes = 1 + static_cast<Eigen::Index>(errors_mm.size());
  WheelReference wheel = reference;
  wheel.rig.modes.modes = Eigen::MatrixXd::Zero(1, wheel.rig.ParameterCount());
  wheel.axis_along_modes = Eigen::MatrixXd::Zero(1, 4);
  wheel.angles_along_modes_rad =
      Eigen::MatrixXd::Zero(1, static_cast<Eigen::Index>(wheel.frames.size()));
  wheel = WithCarcassModes(std::move(wheel), carcass);
  RollingWheel survey = measured;
  survey.angle_along_modes_rad =
      Eigen::MatrixXd::Zero(modes, static_cast<Eigen::Index>(survey.frames.size()));
  OffByThickness both{FindRollingContact(wheel, survey, options), {}};
  for (std::size_t k = 0; k < errors_mm.size(); ++k) carcass.thickness_mm[k] += errors_mm[k];
  both.off = FindRollingContact(wheel, survey, options);
  EXPECT_TRUE(both.found.found && both.off.found);
  EXPECT_EQ(both.found.frames[3].rotation.along_modes.size(), static_cast<std::size_t>(modes));
  EXPECT_LT(both.found.frames[3].rotation.along_modes[0].norm(), 1e-6);  // moves nothing
  EXPECT_GT(both.found.frames[3].deformation.loaded_radius_mm.sigma_calibration(), 0.03);
  return both;
}

// The errors of one thickness are linear: a run with another one is off by what the mode says.
TEST_F(RollingContactOfAnArc, CountsTheErrorOfTheCarcassBesideThoseOfTheCalibration) {
  RollingContactOptions options = Options();
  options.carcass = {{}, {20}};
  const double error_mm = 0.07;
  const OffByThickness both = WithErrors(*reference_, *survey_, options, {error_mm});
  const RigRotationFrame& here = both.found.frames[3].rotation;
  const RigPose foreseen = error_mm / 0.1 * here.along_modes[1];
  const RigPose change = both.off.frames[3].rotation.pose - here.pose;
  EXPECT_GT(std::abs(change[2]), 0.06);
  EXPECT_LT((change - foreseen).norm(), 0.05 * change.norm());
}

// A map is corrected by what touches the ground, so that the patch hangs on it little.
TEST_F(RollingContactOfAnArc, TakesAMapOfTheCarcassToBeAsTheContactSays) {
  RollingContactOptions options = Options();
  const CarcassThickness truth = options.carcass;
  options.carcass = {};
  const std::vector<double> errors_mm{0.05, -0.08, 0.1, 0.06, -0.05, 0.1, -0.07, 0.08, -0.02};
  for (std::size_t k = 0; k < errors_mm.size(); ++k) {
    const std::size_t at = truth.y_mm.size() * (k + 1) / (errors_mm.size() + 2);
    options.carcass.y_mm.push_back(truth.y_mm[at]);
    options.carcass.thickness_mm.push_back(truth.thickness_mm[at]);
  }
  const OffByThickness both = WithErrors(*reference_, *survey_, options, errors_mm);
  const RigRotationFrame& here = both.found.frames[3].rotation;
  const RigPose change = both.off.frames[3].rotation.pose - here.pose;
  EXPECT_GT(change.tail<2>().cwiseAbs().minCoeff(), 1e-5);
  for (int k = 0; k < 3; ++k) EXPECT_LT(std::abs(change[k]), 2 * here.sigma_calibration[k]) << k;
  const FramePatch &patch = both.found.frames[3].patch, &moved = both.off.frames[3].patch;
  ASSERT_EQ(patch.by, FramePatch::By::kLiftOff) << patch.problem;
  ASSERT_EQ(moved.by, FramePatch::By::kLiftOff) << moved.problem;
  const double area_mm2 = patch.patch.area_mm2;
  EXPECT_NE(moved.patch.area_mm2, area_mm2);
  EXPECT_LT(std::abs(moved.patch.area_mm2 - area_mm2), 2 * patch.sigma_calibration[0]);
  EXPECT_LT(patch.sigma_calibration[0], 0.01 * area_mm2);
}

// A right camera that is later by one sigma than was taken out moves the height by as much as the
// mode of the delay says, and what follows from it.
TEST_F(RollingContactOfAnArc, CountsTheErrorOfTheRightCamerasDelay) {
  constexpr double kSigma_s = 1e-5;
  WheelReference wheel = *reference_;
  wheel.rig.modes.modes = Eigen::MatrixXd::Zero(1, wheel.rig.ParameterCount());
  wheel.axis_along_modes = Eigen::MatrixXd::Zero(1, 4);
  wheel.angles_along_modes_rad =
      Eigen::MatrixXd::Zero(1, static_cast<Eigen::Index>(wheel.frames.size()));
  wheel = WithDelayMode(std::move(wheel), {0, kSigma_s});
  RollingWheel survey = *survey_;
  survey.right_delay = {0, kSigma_s};
  survey.angle_along_modes_rad =
      Eigen::MatrixXd::Zero(2, static_cast<Eigen::Index>(survey.frames.size()));
  const RollingContact found = FindRollingContact(wheel, survey, Options());
  for (RollingFrame& frame : survey.frames) {
    for (RollingPoint& p : frame.points) {
      p.right_px -= frame.speed_rad_s * kSigma_s * p.right_flow_px;
      p.point_mm = Triangulate(wheel.rig, {p.left_px, p.right_px}).point_in_rig;
    }
  }
  const RollingContact later = FindRollingContact(wheel, survey, Options());
  ASSERT_TRUE(found.found && later.found);
  const RigRotationFrame& here = found.frames[3].rotation;
  ASSERT_EQ(here.along_modes.size(), 2U);
  EXPECT_LT(here.along_modes[0].norm(), 1e-6);
  const RigPose change = later.frames[3].rotation.pose - here.pose;
  EXPECT_GT(std::abs(change[2]), 0.01);
  EXPECT_NEAR(here.along_modes[1][2], change[2], 0.1 * std::abs(change[2]));
  const WheelDeformation &now = found.frames[3].deformation, &then = later.frames[3].deformation;
  const double shift = then.deflection_mm.value - now.deflection_mm.value;
  EXPECT_GT(std::abs(shift), 0.01);
  EXPECT_NEAR(now.deflection_mm.sigma_calibration(), std::abs(shift), 0.15 * std::abs(shift));
}

TEST_F(RollingContactOfAnArc, RefusesACarcassWithoutThickness) {
  RollingContactOptions options = Options();
  options.carcass = {};
  EXPECT_THROW((void)FindRollingContact(*reference_, *survey_, options), UsageError);
}

}  // namespace
}  // namespace plumbline
