#include "track/wheel_tags.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/support/consistency.h"
#include "tests/track/lifted_wheel.h"
#include "tests/track/tagged_wheel.h"

namespace plumbline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::kDegrees;
using testing::LiftedWheel;
using testing::TaggedWheel;

constexpr double kNoise_px = 0.1;

std::vector<TagSighting> Recording(const TaggedWheel& truth, double sigma_px,
                                   std::mt19937& random) {
  std::vector<TagSighting> sightings;
  for (std::size_t f = 0; f < truth.wheel.frames.size(); ++f) {
    sightings.push_back({f, truth.See(truth.wheel.frames[f].angle_rad, sigma_px, random)});
  }
  return sightings;
}

Eigen::Matrix<double, 12, 1> CornersOf(const WheelTag& tag) {
  Eigen::Matrix<double, 12, 1> all;
  for (Eigen::Index k = 0; k < 4; ++k) {
    all.segment<3>(3 * k) = tag.corner_mm[static_cast<std::size_t>(k)];
  }
  return all;
}

// The corners' noise and what all angles are off together are drawn anew.
TEST(WheelTags, CornersAreWithinTheirSigmas) {
  TaggedWheel truth(12, 384, 8);
  truth.AddFrames(100);
  std::mt19937 random(5);
  std::normal_distribution<double> normal(0, 1);
  constexpr double kAngle_rad = 1e-4;
  truth.wheel.cov_angles_random_rad2 = kAngle_rad * kAngle_rad * Eigen::MatrixXd::Ones(100, 100);
  testing::Consistency consistency;
  double sigma_px = 0;
  constexpr int kDraws = 25;
  for (int draw = 0; draw < kDraws; ++draw) {
    const std::vector<TagSighting> sightings = Recording(truth, kNoise_px, random);
    WheelReference measured = truth.wheel;
    const double off = kAngle_rad * normal(random);
    for (WheelFrame& frame : measured.frames) frame.angle_rad += off;
    const WheelTagsFound found = MakeWheelTags(measured, "tag36h11", {}, sightings);
    EXPECT_THAT(found.problems, IsEmpty());
    ASSERT_EQ(found.tags.tags.size(), 12U);
    sigma_px += found.tags.sigma_px / kDraws;
    for (const WheelTag& tag : found.tags.tags) {
      EXPECT_GT(tag.frames, 5);
      consistency.AddJoint(CornersOf(tag) - CornersOf(*truth.wheel.tags.Find(tag.id)),
                           tag.cov_random_mm2);
    }
  }
  consistency.Print("corners of tags, mm");
  EXPECT_NEAR(consistency.nees(), 1, 0.1);
  EXPECT_NEAR(consistency.coverage(), 0.95, 0.02);
  EXPECT_NEAR(sigma_px, kNoise_px, 0.03 * kNoise_px);
}

TEST(WheelTags, MoveAlongTheModesAsWhenAllIsFoundAnew) {
  TaggedWheel truth(6, 384, 24);
  truth.AddFrames(40);
  truth.AddModes();
  std::mt19937 random(6);
  const std::vector<TagSighting> sightings = Recording(truth, kNoise_px, random);
  WheelReference& wheel = truth.wheel;
  wheel.axis_along_modes.resize(3, 4);
  wheel.axis_along_modes << 1e-5, 0, 2e-5, 0.02, 0, 1e-5, 0, -0.03, 0, 0, 0, 0.05;
  wheel.angles_along_modes_rad = 1e-5 * Eigen::MatrixXd::Ones(3, 40);
  const WheelTagsFound found = MakeWheelTags(wheel, "tag36h11", {}, sightings);
  for (int k = 0; k < 3; ++k) {
    WheelReference moved = wheel;
    moved.rig = wheel.rig.AlongMode(k);
    moved.axis = wheel.axis.Off(wheel.axis_along_modes.row(k).transpose());
    for (WheelFrame& frame : moved.frames) frame.angle_rad += 1e-5;
    const WheelTagsFound anew = MakeWheelTags(moved, "tag36h11", {}, sightings);
    for (const WheelTag& tag : found.tags.tags) {
      const Eigen::VectorXd change = CornersOf(*anew.tags.Find(tag.id)) - CornersOf(tag);
      EXPECT_LT((change - tag.along_modes_mm.row(k).transpose()).norm(),
                0.03 * change.norm() + 1e-4)
          << k << " " << tag.id;
      EXPECT_GT(change.norm(), 1e-3);
    }
  }
}

TEST(WheelTags, SayWhichAreLeftOutAndWhy) {
  TaggedWheel truth(6, 384, 24);
  truth.AddFrames(60);
  std::mt19937 random(7);
  std::vector<TagSighting> sightings = Recording(truth, kNoise_px, random);
  int misread = 0, alone = 0;
  for (TagSighting& sighting : sightings) {
    for (StereoTag& tag : sighting.seen.tags) {
      if (tag.id == 4) tag.id = 1;  // one number on two tags
      if (tag.id == 2 && misread++ == 0) {
        for (auto* px : {&tag.left_px, &tag.right_px}) {
          for (Eigen::Vector2d& p : *px) p.x() += 70;
        }
      }
      if (tag.id == 5 && alone++ > 0) tag.id = 0;  // too far from 0: left out there
    }
    std::erase_if(sighting.seen.tags, [](const StereoTag& tag) { return tag.id == 0; });
  }
  const std::vector<int> rim = {2, 3, 17};
  const WheelTagsFound found = MakeWheelTags(truth.wheel, "tag36h11", rim, sightings);
  std::vector<int> ids;
  for (const WheelTag& tag : found.tags.tags) ids.push_back(tag.id);
  EXPECT_THAT(ids, ElementsAre(2, 3));
  EXPECT_TRUE(found.tags.tags[0].on_rim);
  EXPECT_LT((found.tags.tags[0].Centre() - truth.wheel.tags.tags[2].Centre()).norm(), 0.2);
  EXPECT_NEAR(found.tags.tags[0].SideMm(), 24, 0.2);
  EXPECT_THAT(found.problems,
              ::testing::UnorderedElementsAre(HasSubstr("tag 1 is on the wheel more than once"),
                                              HasSubstr("tag 5 is seen in one frame alone"),
                                              HasSubstr("tag 17, said to be on the rim")));
  EXPECT_EQ(found.tags.Find(1), nullptr);
}

// Twice in one image, again and again, is no chance.
TEST(WheelTags, AreRefusedWhenAnImageShowsThemTwice) {
  TaggedWheel truth(6, 384, 24);
  truth.AddFrames(30);
  std::mt19937 random(8);
  std::vector<TagSighting> sightings = Recording(truth, kNoise_px, random);
  sightings[3].seen.twice = {2, 3};
  sightings[4].seen.twice = {2};
  const WheelTagsFound found = MakeWheelTags(truth.wheel, "tag36h11", {}, sightings);
  EXPECT_THAT(found.problems, ElementsAre(HasSubstr("tag 2 is on the wheel more than once")));
  EXPECT_NE(found.tags.Find(3), nullptr);
}

TEST(PlaceByTags, TellsTheAngleOrWhatIsWrong) {
  TaggedWheel truth(24, 384, 24);
  std::mt19937 random(9);
  for (const double angle : {0.1, 1.7, 6.2}) {
    const StereoTags seen = truth.See(angle, kNoise_px, random);
    ASSERT_GE(seen.tags.size(), 2U);
    const TagPlace place = PlaceByTags(truth.wheel, seen);
    ASSERT_TRUE(place.found);
    EXPECT_NEAR(place.angle_rad, angle, 0.1 * kDegrees);
    EXPECT_EQ(place.known, static_cast<int>(seen.tags.size()));
    EXPECT_TRUE(place.Allows(angle - 2 * std::numbers::pi + 4 * kDegrees));
    EXPECT_FALSE(place.Allows(angle + 6 * kDegrees));
    EXPECT_THAT(place.Contradiction(angle + 6 * kDegrees), HasSubstr("-6.0 degrees"));
  }
  EXPECT_TRUE(PlaceByTags(truth.wheel, {}).Allows(3));

  StereoTags seen = truth.See(0.5, 0, random);
  WheelReference wheel = truth.wheel;
  wheel.tags.tags.erase(wheel.tags.tags.begin() + seen.tags[0].id);
  const TagPlace fewer = PlaceByTags(wheel, seen);
  EXPECT_TRUE(fewer.found);
  EXPECT_THAT(fewer.unknown, ElementsAre(seen.tags[0].id));

  std::swap(seen.tags[0].left_px, seen.tags[1].left_px);
  std::swap(seen.tags[0].right_px, seen.tags[1].right_px);
  const TagPlace wrong = PlaceByTags(truth.wheel, seen);
  EXPECT_FALSE(wrong.found);
  EXPECT_THAT(wrong.why, HasSubstr("contradict each other"));
}

// The tyre is drawn along; the rim is not.
TEST(PlaceByTags, HoldsToTheRim) {
  TaggedWheel truth(12, 384, 24);
  std::mt19937 random(10);
  const StereoTags seen = truth.See(0.5, 0, random);
  WheelReference wheel = truth.wheel;
  for (WheelTag& tag : wheel.tags.tags) {
    tag.on_rim = tag.id == seen.tags[0].id;
    if (tag.on_rim) continue;
    const Eigen::Matrix3d drawn = TurnAboutY(3 * kDegrees);
    for (Eigen::Vector3d& corner : tag.corner_mm) corner = drawn * corner;
  }
  const TagPlace place = PlaceByTags(wheel, seen);
  ASSERT_TRUE(place.found) << place.why;
  EXPECT_EQ(place.rim, 1);
  EXPECT_NEAR(place.angle_rad, 0.5, 0.01 * kDegrees);
}

// On rendered images, a quarter of the pixels of the thesis' rig.
TEST(FindStereoTags, FindsThemInBothImagesOfATyre) {
  Scenario scenario = LiftedWheel::ScenarioOf(2, 6 * kDegrees);
  scenario.tags = WheelTagOptions::Parse("36h11:24:24mm");
  LiftedWheel tagged(scenario);
  const StereoFrame& pair = tagged.Pair(0);
  const StereoTags found = FindStereoTags(tagged.rig(), pair.left, pair.right, "tag36h11");
  EXPECT_THAT(found.twice, IsEmpty());
  ASSERT_GE(found.tags.size(), 2U);
  const auto truth = tagged.virtual_rig().Truth(0);
  for (const StereoTag& tag : found.tags) {
    const auto corners =
        WheelTagCorners(tagged.virtual_rig().surface().Domain(), *scenario.tags, tag.id);
    for (std::size_t k = 0; k < 4; ++k) {
      const TruePoint point = truth->OfMaterial(corners[k]);
      EXPECT_LT((tag.left_px[k] - point.left_px).norm(), 0.6) << tag.id;
      EXPECT_LT((tag.right_px[k] - point.right_px).norm(), 0.6) << tag.id;
    }
  }
  // Shifted by 5 px no corner lies on its epipolar line.
  GrayImage lower = pair.right;
  for (int y = lower.height() - 1; y >= 5; --y) {
    for (int x = 0; x < lower.width(); ++x) lower.grey(y, x) = pair.right.grey(y - 5, x);
  }
  EXPECT_THAT(FindStereoTags(tagged.rig(), pair.left, lower, "tag36h11").tags, IsEmpty());
  // The same image beside itself: every tag is there twice.
  GrayImage twice{Image<std::uint16_t>({2 * pair.left.width(), pair.left.height()}, 0),
                  pair.left.bits};
  for (int y = 0; y < twice.height(); ++y) {
    for (int x = 0; x < twice.width(); ++x) {
      twice.grey(y, x) = pair.left.grey(y, x % pair.left.width());
    }
  }
  const StereoTags doubled = FindStereoTags(tagged.rig(), twice, pair.right, "tag36h11");
  EXPECT_THAT(doubled.tags, IsEmpty());
  EXPECT_GE(doubled.twice.size(), found.tags.size());
}

}  // namespace
}  // namespace plumbline
