// A rolling tyre found on its wheel by tags, on rendered images.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/track/lifted_wheel.h"
#include "track/rolling_survey.h"
#include "track/wheel_tags.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::kDegrees;
using testing::LiftedWheel;

constexpr double kFrame_s = 0.1;

Scenario Tagged(Scenario scenario) {
  scenario.tags = WheelTagOptions::Parse("36h11:24:24mm");
  return scenario;
}

// The reference of a part of a wheel with tags; the same wheel lifted again, and loaded.
class SurveyWithTags : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    LiftedWheel lifted(Tagged(LiftedWheel::ScenarioOf(5, 6 * kDegrees)));
    reference_ = new WheelReference(testing::ReferenceOf(lifted));
    std::vector<TagSighting> sightings;
    for (std::size_t f = 0; f < 5; ++f) {
      const StereoFrame& pair = lifted.Pair(static_cast<int>(f));
      sightings.push_back({f, FindStereoTags(lifted.rig(), pair.left, pair.right, "tag36h11")});
    }
    const WheelTagsFound found = MakeWheelTags(*reference_, "tag36h11", {}, sightings);
    reference_->tags = found.tags;
    ASSERT_GE(found.tags.tags.size(), 4U);
    Scenario again = Tagged(LiftedWheel::ScenarioOf(5, 6 * kDegrees));
    again.seed = 9;
    lifted_ = new LiftedWheel(again);
    std::get<TyreOptions>(again.surface).lifted_mm = 0;
    loaded_ = new LiftedWheel(again);
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete lifted_;
    delete loaded_;
  }
  static RollingSurveyOptions Options() {
    RollingSurveyOptions options;
    options.matching.field.correlator.subset_px = 17;
    return options;
  }
  static RollingFrame Add(RollingSurvey& survey, LiftedWheel& wheel, int f) {
    return survey.Add(f, f * kFrame_s, wheel.Pair(f).left, wheel.Pair(f).right);
  }

  static WheelReference* reference_;
  static LiftedWheel *lifted_, *loaded_;
};

WheelReference* SurveyWithTags::reference_ = nullptr;
LiftedWheel* SurveyWithTags::lifted_ = nullptr;
LiftedWheel* SurveyWithTags::loaded_ = nullptr;

TEST_F(SurveyWithTags, FindsALoadedTyreByThem) {
  RollingSurvey survey(*reference_, Options());
  const PlacedBy expected[3] = {PlacedBy::kTags, PlacedBy::kTags, PlacedBy::kFollowed};
  for (int f = 0; f < 3; ++f) {
    const RollingFrame frame = Add(survey, *loaded_, f);
    ASSERT_EQ(frame.status, RollingFrameStatus::kPlaced) << frame.problem;
    EXPECT_EQ(frame.placed_by, expected[f]) << f;
    EXPECT_GE(frame.tag_place.known, 1);
    EXPECT_EQ(frame.tag_place.rim, 0);
    EXPECT_NEAR(frame.tag_place.angle_rad, loaded_->Angle(f), 1.5 * kDegrees);
  }
  const RollingWheel wheel = survey.Finish();
  EXPECT_FALSE(wheel.twist.known);  // tags on the tyre tell no angle of the rim
  for (std::size_t f = 1; f < 3; ++f) {
    EXPECT_NEAR(wheel.frames[f].angle_rad - wheel.frames[0].angle_rad,
                loaded_->Angle(static_cast<int>(f)), 0.006 * kDegrees);
  }
}

TEST_F(SurveyWithTags, MarksAFrameWhoseTagsContradictItsSurface) {
  WheelReference moved = *reference_;
  const Eigen::Matrix3d turn = TurnAboutY(7 * kDegrees);
  for (WheelTag& tag : moved.tags.tags) {
    for (Eigen::Vector3d& corner : tag.corner_mm) corner = turn * corner;
  }
  RollingSurvey survey(moved, Options());
  const RollingFrame frame = Add(survey, *loaded_, 1);
  EXPECT_EQ(frame.status, RollingFrameStatus::kNotFound);
  EXPECT_EQ(frame.placed_by, PlacedBy::kNothing);
  EXPECT_THAT(frame.problem, HasSubstr("its tags contradict its surface"));
  EXPECT_THAT(frame.points, IsEmpty());
  // Each at another's place.
  WheelReference mixed = *reference_;
  for (WheelTag& tag : mixed.tags.tags) {
    const Eigen::Matrix3d there = TurnAboutY((tag.id % 2 == 0 ? 20 : -20) * kDegrees);
    for (Eigen::Vector3d& corner : tag.corner_mm) corner = there * corner;
  }
  RollingSurvey other(mixed, Options());
  EXPECT_THAT(Add(other, *loaded_, 1).problem, HasSubstr("contradict each other"));
}

TEST_F(SurveyWithTags, FindsByFeaturesWhatShowsNoTag) {
  WheelReference without = *reference_;
  without.tags.tags.clear();
  RollingSurvey survey(without, Options());
  const RollingFrame frame = Add(survey, *loaded_, 0);
  EXPECT_EQ(frame.placed_by, PlacedBy::kFeatures) << frame.problem;
  EXPECT_FALSE(frame.tag_place.unknown.empty());
}

// The lifted wheel is not drawn along: its tags are as good as tags on a rim.
TEST_F(SurveyWithTags, TakesTheAngleOfTheRim) {
  WheelReference rim = *reference_;
  for (WheelTag& tag : rim.tags.tags) tag.on_rim = true;
  RollingSurvey survey(rim, Options());
  for (int f = 1; f < 3; ++f)
    EXPECT_EQ(Add(survey, *lifted_, f).status, RollingFrameStatus::kPlaced);
  const RollingWheel wheel = survey.Finish();
  ASSERT_TRUE(wheel.twist.known);
  EXPECT_EQ(wheel.twist.frames, 2);
  EXPECT_LT(std::abs(wheel.twist.angle_rad), 3 * wheel.twist.sigma_random_rad);
  EXPECT_LT(wheel.sigma_common_rad, 0.05 * kDegrees);
  for (std::size_t f = 0; f < 2; ++f) {
    EXPECT_NEAR(wheel.frames[f].angle_rad, lifted_->Angle(static_cast<int>(f) + 1),
                3 * wheel.sigma_common_rad);
  }
}

}  // namespace
}  // namespace plumbline
