#include "apps/internal/tag_records.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/track/tagged_wheel.h"

namespace plumbline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Three frames: found by tags, following, contradicted by its tags.
RollingWheel Rolling() {
  RollingWheel rolling;
  rolling.frames.resize(3);
  for (RollingFrame& frame : rolling.frames) {
    frame.status = RollingFrameStatus::kPlaced;
    frame.tag_place.known = 2;
    frame.tag_place.found = true;
    frame.tag_place.angle_rad = 0.5;
  }
  rolling.frames[0].placed_by = PlacedBy::kTags;
  rolling.frames[0].tag_place.rim = 1;
  rolling.frames[1].placed_by = PlacedBy::kFollowed;
  rolling.frames[1].tag_place.unknown = {17};
  RollingFrame& wrong = rolling.frames[2];
  wrong.status = RollingFrameStatus::kNotFound;
  wrong.problem = wrong.tag_place.why = "its tags contradict its surface";
  return rolling;
}

TEST(TagRecords, SayHowAFrameWasFound) {
  RollingWheel rolling = Rolling();
  const PlacementRecord first = internal::PlacementRecordOf(rolling, 0);
  EXPECT_TRUE(first.found);
  EXPECT_EQ(first.placed_by, 2);
  EXPECT_EQ(first.tags, 2);
  EXPECT_EQ(first.rim_tags, 1);
  EXPECT_EQ(first.tag_angle_rad, 0.5);
  EXPECT_TRUE(std::isnan(first.twist_rad));
  EXPECT_EQ(internal::PlacementRecordOf(rolling, 1).unknown_tags, 1);
  const PlacementRecord wrong = internal::PlacementRecordOf(rolling, 2);
  EXPECT_FALSE(wrong.found);
  EXPECT_EQ(wrong.problem, "its tags contradict its surface");
  EXPECT_TRUE(std::isnan(wrong.tags));

  rolling.twist = {.known = true,
                   .angle_rad = 0.008,
                   .sigma_random_rad = 1e-4,
                   .sigma_calibration_rad = 2e-4,
                   .corner_sigma_px = 0.1,
                   .frames = 1};
  EXPECT_TRUE(std::isnan(internal::PlacementRecordOf(rolling, 1).sigma_calibration_twist_rad));
  rolling.angle_along_modes_rad = Eigen::MatrixXd::Zero(1, 3);
  const PlacementRecord twisted = internal::PlacementRecordOf(rolling, 1);
  EXPECT_EQ(twisted.twist_rad, 0.008);
  EXPECT_EQ(twisted.sigma_random_twist_rad, 1e-4);
  EXPECT_EQ(twisted.sigma_calibration_twist_rad, 2e-4);
}

TEST(TagRecords, TellTheUserWhatHeShouldKnow) {
  testing::TaggedWheel tagged(2, 384, 24);
  RollingWheel rolling = Rolling();
  EXPECT_THAT(
      internal::TagNotes(tagged.wheel, rolling),
      ElementsAre(HasSubstr("seen in 3 of 3 frames. 1 were found on the wheel by their "
                            "tags, 0 by their features, 1 follow"),
                  HasSubstr("In 1 frames the tags contradict"), HasSubstr(" 17 (1 frames)")));
  rolling.twist = {.known = true,
                   .angle_rad = 0.45 * std::numbers::pi / 180,
                   .sigma_random_rad = 1e-5,
                   .sigma_calibration_rad = 0,
                   .corner_sigma_px = 0.1,
                   .frames = 2,
                   .steady = false};
  const std::string twist = internal::TagNotes(tagged.wheel, rolling).back();
  EXPECT_THAT(twist, HasSubstr("by its tags in 2 frames"));
  EXPECT_THAT(twist, HasSubstr("0.4500 degrees"));
  EXPECT_THAT(twist, HasSubstr("changes from frame to frame"));
  EXPECT_THAT(twist, ::testing::Not(HasSubstr("calibration")));
  tagged.wheel.tags.sigma_px = 0.01;
  EXPECT_THAT(internal::TagNotes(tagged.wheel, rolling).back(),
              HasSubstr("0.10 px off where the wheel's reference has them, 10 times"));
  tagged.wheel.tags = {};
  EXPECT_THAT(internal::TagNotes(tagged.wheel, rolling), IsEmpty());
}

}  // namespace
}  // namespace plumbline
