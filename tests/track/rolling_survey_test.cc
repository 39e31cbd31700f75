#include "track/rolling_survey.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using testing::kDegrees;
using testing::LiftedWheel;

// The loaded tyre, seen by the rig that made the reference of a part of it.
class RollingSurveyOfAnArc : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    LiftedWheel lifted(6, 6 * kDegrees);
    reference_ = new WheelReference(testing::ReferenceOf(lifted));
    rolling_ = new LiftedWheel(Loaded());
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete rolling_;
  }

  static Scenario Loaded() {
    Scenario loaded = LiftedWheel::ScenarioOf(6, 5 * kDegrees);
    std::get<TyreOptions>(loaded.surface).lifted_mm = 0;
    loaded.seed = 9;
    return loaded;
  }
  static RollingSurveyOptions Options() {
    RollingSurveyOptions options;
    options.matching.field.correlator.subset_px = 17;
    return options;
  }

  static WheelReference* reference_;
  static LiftedWheel* rolling_;
};

WheelReference* RollingSurveyOfAnArc::reference_ = nullptr;
LiftedWheel* RollingSurveyOfAnArc::rolling_ = nullptr;

// Mud on the lens, or a hand before it: the left share of both images is grey.
GrayImage Covered(GrayImage image, double share) {
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < share * image.width(); ++x) image.grey(y, x) = 60;
  }
  return image;
}

TEST_F(RollingSurveyOfAnArc, FindsTheAnglesOfALoadedTyreAndMarksWhatIsNotIt) {
  RollingSurvey survey(*reference_, Options());
  constexpr double kFrame_s = 0.1;
  for (int f = 0; f < 4; ++f) {
    const RollingFrame& frame =
        survey.Add(f, f * kFrame_s, rolling_->Pair(f).left, rolling_->Pair(f).right);
    EXPECT_EQ(frame.status, RollingFrameStatus::kPlaced) << frame.problem;
  }
  survey.AddUnreadable(4, 4 * kFrame_s, "00004.png is damaged");
  const StereoFrame& pair = rolling_->Pair(5);
  const RollingFrame covered = survey.Add(5, 5 * kFrame_s, Covered(pair.left, 0.9), pair.right);
  EXPECT_EQ(covered.status, RollingFrameStatus::kNotFound);
  EXPECT_THAT(covered.problem, HasSubstr("features"));
  Scenario other = Loaded();
  other.speckle.seed += 1;
  LiftedWheel another(other);
  const RollingFrame foreign =
      survey.Add(6, 6 * kFrame_s, another.Pair(2).left, another.Pair(2).right);
  EXPECT_EQ(foreign.status, RollingFrameStatus::kNotFound);
  EXPECT_FALSE(foreign.problem.empty());
  const RollingFrame no_right =
      survey.Add(7, 7 * kFrame_s, pair.left, testing::Wall(reference_->rig));
  EXPECT_EQ(no_right.status, RollingFrameStatus::kNotFound);
  EXPECT_THAT(no_right.problem, HasSubstr("found in both images"));
  EXPECT_THROW((void)survey.Add(8, 1, {Image<std::uint16_t>({100, 80}, 3), 8}, pair.right),
               InputError);

  const RollingWheel wheel = survey.Finish();
  ASSERT_EQ(wheel.frames.size(), 8U);
  EXPECT_EQ(wheel.placed(), 4);
  const double speed = 5 * kDegrees / kFrame_s;
  for (std::size_t f = 0; f < 8; ++f) {
    const RollingFrame& frame = wheel.frames[f];
    if (f >= 4) {
      EXPECT_TRUE(std::isnan(frame.angle_rad)) << f;
      EXPECT_TRUE(frame.points.empty());
      continue;
    }
    const double turned = rolling_->Angle(static_cast<int>(f));
    EXPECT_NEAR(frame.angle_rad - wheel.frames[0].angle_rad, turned, 0.005 * kDegrees) << f;
    EXPECT_LT(frame.sigma_random_rad, 0.003 * kDegrees);
    EXPECT_NEAR(frame.speed_rad_s, speed, 0.002 * speed);
    EXPECT_TRUE(std::isnan(frame.sigma_calibration_rad));  // this rig does not tell
    EXPECT_GT(frame.points.size(), 60U);
  }
  EXPECT_LT(wheel.sigma_common_rad, 0.3 * kDegrees);
  // The points are of the material that they are said to be: the tyre is pressed in below.
  const RollingFrame& frame = wheel.frames[2];
  const Rigid3 wheel_from_rig = reference_->axis.RigFromWheel(frame.angle_rad).Inverse();
  double deepest = 0;
  for (const RollingPoint& p : frame.points) {
    const Eigen::Vector3d now = wheel_from_rig * p.point_mm;
    const Eigen::Vector3d moved = now - p.undeformed_mm;
    EXPECT_LT(moved.norm(), 22);
    EXPECT_NEAR(moved.y(), 0, 5);
    deepest = std::min(deepest, std::hypot(now.x(), now.z()) -
                                    std::hypot(p.undeformed_mm.x(), p.undeformed_mm.z()));
  }
  EXPECT_NEAR(deepest, -18, 1.5);
}

TEST_F(RollingSurveyOfAnArc, MovesBackWhatALateRightCameraSaw) {
  Scenario late = Loaded();
  late.right_delay_s = 2e-4;
  LiftedWheel wheel(late);
  RollingSurvey survey(*reference_, Options());
  for (int f = 0; f < 3; ++f) {
    (void)survey.Add(f, wheel.virtual_rig().FrameTime(f), wheel.Pair(f).left, wheel.Pair(f).right);
  }
  RollingWheel rolling = survey.Finish();
  // How far the points are from where they are, along the line of sight: mean.
  const auto too_near = [&] {
    const auto truth = wheel.virtual_rig().Truth(1);
    const Rigid3 rig_from_ground = truth->ground_from_rig().Inverse();
    double sum = 0;
    for (const RollingPoint& p : rolling.frames[1].points) {
      const auto point = truth->UnderLeftPixel(p.left_px);
      if (point) sum += (rig_from_ground * point->position_mm - p.point_mm).z();
    }
    return sum / static_cast<double>(rolling.frames[1].points.size());
  };
  ASSERT_EQ(rolling.placed(), 3);
  EXPECT_GT(std::abs(too_near()), 0.3);
  survey.MoveBack({2e-4, 0}, &rolling);
  EXPECT_LT(std::abs(too_near()), 0.03);
  EXPECT_EQ(rolling.right_delay.value_s, 2e-4);
  EXPECT_THROW(survey.MoveBack({1, 0}, &rolling), UsageError);
}

// What the contact draws along stays where the ground is, while the arm swings.
TEST_F(RollingSurveyOfAnArc, HoldsTheDeformationToTheGroundUnderARigThatSwings) {
  Scenario swinging = Loaded();
  swinging.motion.flexure_rad_per_m_s2 = 1.5 * kDegrees;
  std::get<TyreOptions>(swinging.surface).speed_swing_mm_s = 400;
  LiftedWheel wheel(swinging);
  RollingSurvey survey(*reference_, Options());
  std::vector<GroundPitch> pitch;
  std::vector<double> true_rad;
  for (int f = 0; f < wheel.frames(); ++f) {
    const double t = wheel.virtual_rig().FrameTime(f);
    (void)survey.Add(f, t, wheel.Pair(f).left, wheel.Pair(f).right);
    const Eigen::Vector3d normal = reference_->axis.rotation.transpose() *
                                   wheel.virtual_rig().GroundFromRig(t).rotation.row(2).transpose();
    pitch.push_back({std::atan2(normal.x(), normal.z()), 0});
    true_rad.push_back(wheel.Angle(f) + pitch.back().value_rad);
  }
  RollingWheel rolling = survey.Finish();
  ASSERT_EQ(rolling.placed(), wheel.frames());
  // Of the turns since the first frame, largest.
  const auto off = [&] {
    double most = 0;
    for (std::size_t f = 0; f < true_rad.size(); ++f) {
      const double turn = rolling.frames[f].angle_rad - rolling.frames[0].angle_rad;
      most = std::max(most, std::abs(turn - (true_rad[f] - true_rad[0])));
    }
    return most;
  };
  ASSERT_GT(std::abs(pitch.back().value_rad - pitch.front().value_rad), 5 * kDegrees);
  EXPECT_GT(off(), 0.2 * kDegrees);
  survey.HoldToGround(pitch, &rolling);
  EXPECT_LT(off(), 0.01 * kDegrees);
  EXPECT_LT(off(), 2 * rolling.frames.back().sigma_random_turn_rad);
  EXPECT_LT(rolling.frames.back().sigma_random_turn_rad, 0.01 * kDegrees);
  // A frame whose pitch is off has its angle off by as much as is claimed.
  const double exact_rad = rolling.frames[3].measured_angle_rad;
  const double sigma_rad = rolling.frames[3].sigma_measured_rad;
  constexpr double kOff_rad = 0.5 * kDegrees;
  pitch[3].value_rad += kOff_rad;
  survey.HoldToGround(pitch, &rolling);
  const double moved_rad = std::abs(rolling.frames[3].measured_angle_rad - exact_rad);
  pitch[3] = {pitch[3].value_rad - kOff_rad, kOff_rad};
  survey.HoldToGround(pitch, &rolling);
  EXPECT_EQ(rolling.frames[3].measured_angle_rad, exact_rad);
  EXPECT_NEAR(std::sqrt(std::pow(rolling.frames[3].sigma_measured_rad, 2) - sigma_rad * sigma_rad),
              moved_rad, 0.3 * moved_rad);
  EXPECT_GT(moved_rad, 5 * sigma_rad);
  EXPECT_THROW(survey.HoldToGround({}, &rolling), std::invalid_argument);
}

TEST_F(RollingSurveyOfAnArc, FollowsARightCameraThatVibrates) {
  Scenario shaken = Loaded();
  shaken.motion.vibration_rad = 0.05 * kDegrees;
  LiftedWheel wheel(shaken);
  const StereoFrame& pair = wheel.Pair(1);
  RollingSurveyOptions options = Options();
  options.refinement = PoseRefinement::kWhenSignificant;
  RollingSurvey follows(*reference_, options), does_not(*reference_, Options());
  const RollingFrame with = follows.Add(1, 0.1, pair.left, pair.right);
  const RollingFrame without = does_not.Add(1, 0.1, pair.left, pair.right);
  ASSERT_TRUE(with.right_from_left.has_value()) << with.problem;
  EXPECT_EQ(with.right_from_left_moved.size(), 5U);
  EXPECT_FALSE(without.right_from_left.has_value());
  // Held against the truth: mean distance of the points.
  const auto truth = wheel.virtual_rig().Truth(1);
  EXPECT_TRUE(truth->right_from_left().rotation.isApprox(with.right_from_left->rotation, 2e-4));
  const auto off = [&](const RollingFrame& frame) {
    double sum = 0;
    for (const RollingPoint& p : frame.points) {
      const auto point = truth->UnderLeftPixel(p.left_px);
      const Rigid3 rig_from_ground =
          wheel.virtual_rig().GroundFromRig(wheel.virtual_rig().FrameTime(1)).Inverse();
      if (point) sum += (rig_from_ground * point->position_mm - p.point_mm).norm();
    }
    return sum / static_cast<double>(frame.points.size());
  };
  EXPECT_GT(off(without), 0.1);
  EXPECT_LT(off(with), 0.3 * off(without));
  // In one where it stands still nothing is beyond doubt; but it has moved, so that its pose there
  // is not known better than it is told.
  const RollingFrame still = follows.Add(2, 0.2, rolling_->Pair(2).left, rolling_->Pair(2).right);
  EXPECT_FALSE(still.right_from_left.has_value());
  const RollingWheel told = follows.Finish();
  EXPECT_EQ(told.refinement, PoseRefinement::kAlways);
  const RollingFrame& refined = told.frames[1];
  ASSERT_TRUE(refined.right_from_left.has_value());
  EXPECT_EQ(refined.right_from_left_moved.size(), 5U);
  ASSERT_EQ(refined.points.size(), still.points.size());
  EXPECT_NE(refined.points[0].point_mm, still.points[0].point_mm);
  // As a survey says that refines all frames from the start (which finds matches from elsewhere).
  options.refinement = PoseRefinement::kAlways;
  RollingSurvey always(*reference_, options);
  (void)always.Add(1, 0.1, pair.left, pair.right);
  (void)always.Add(2, 0.2, rolling_->Pair(2).left, rolling_->Pair(2).right);
  const RollingWheel same = always.Finish();
  for (std::size_t f = 0; f < 2; ++f) {
    EXPECT_NEAR(told.frames[f].angle_rad, same.frames[f].angle_rad, 1e-6);
    EXPECT_LT((told.frames[f].points[0].point_mm - same.frames[f].points[0].point_mm).norm(), 0.01);
  }
}

TEST_F(RollingSurveyOfAnArc, KeepsTheCalibratedPoseOfCamerasThatStandStill) {
  RollingSurveyOptions options = Options();
  options.refinement = PoseRefinement::kWhenSignificant;
  RollingSurvey survey(*reference_, options);
  for (int f = 1; f < 3; ++f) {
    (void)survey.Add(f, 0.1 * f, rolling_->Pair(f).left, rolling_->Pair(f).right);
  }
  const RollingWheel rolling = survey.Finish();
  EXPECT_EQ(rolling.refinement, PoseRefinement::kWhenSignificant);
  for (const RollingFrame& frame : rolling.frames) {
    EXPECT_FALSE(frame.right_from_left.has_value());
  }
}

// Frames before only tell where to start.
TEST_F(RollingSurveyOfAnArc, SaysTheSameOfAFrameWhateverCameBefore) {
  constexpr double kFrame_s = 0.1;
  constexpr int kLast = 4;
  const auto survey = [&](const std::vector<int>& frames) {
    RollingSurvey following(*reference_, Options());
    int n = 0;
    for (const int f : frames) {
      following.Add(n, n * kFrame_s, rolling_->Pair(f).left, rolling_->Pair(f).right);
      ++n;
    }
    return following.Finish();
  };
  const RollingWheel alone = survey({kLast});
  ASSERT_EQ(alone.placed(), 1);
  const RollingFrame& searched = alone.frames.front();
  // After a turn as steady as it gets; and after it jumped, which the last two frames do not
  // foresee.
  for (const std::vector<int>& frames : {std::vector{0, 1, 2, 3, kLast}, {3, 0, 1, kLast}}) {
    const RollingWheel wheel = survey(frames);
    ASSERT_EQ(wheel.placed(), static_cast<int>(frames.size()));
    const RollingFrame& frame = wheel.frames.back();
    ASSERT_EQ(frame.view, searched.view);
    std::map<int, const RollingPoint*> by_place;
    for (const RollingPoint& p : searched.points) by_place[p.place] = &p;
    std::size_t both = 0;
    for (const RollingPoint& p : frame.points) {
      const auto there = by_place.find(p.place);
      if (there == by_place.end()) continue;
      ++both;
      EXPECT_LT((p.left_px - there->second->left_px).norm(), 0.01);
      EXPECT_LT((p.right_px - there->second->right_px).norm(), 0.01);
    }
    EXPECT_GE(both, searched.points.size() * 97 / 100);
  }
}

TEST_F(RollingSurveyOfAnArc, RefusesOptionsThatMakeNoSense) {
  RollingSurveyOptions options = Options();
  options.least_points = 3;
  EXPECT_THROW(RollingSurvey(*reference_, options), UsageError);
  options = Options();
  options.most_scatter_rad = 0;
  EXPECT_THROW(RollingSurvey(*reference_, options), UsageError);
  EXPECT_TRUE(RollingSurvey(*reference_, Options()).Finish().frames.empty());
}

}  // namespace
}  // namespace plumbline
