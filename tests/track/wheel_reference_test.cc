#include "track/wheel_reference.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "calib/error.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {

using testing::ChainOf;
using testing::kDegrees;
using testing::LiftedWheel;
using testing::LiftedWheelOptions;

// A sixth of the wheel, made into a reference.
class WheelReferenceOfAnArc : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    wheel_ = new LiftedWheel(10, 6 * kDegrees);
    reference_ = new WheelReference(testing::ReferenceOf(*wheel_, {4}));
  }
  static void TearDownTestSuite() {
    delete reference_;
    delete wheel_;
  }

  static LiftedWheel* wheel_;
  static WheelReference* reference_;
};

LiftedWheel* WheelReferenceOfAnArc::wheel_ = nullptr;
WheelReference* WheelReferenceOfAnArc::reference_ = nullptr;

// Moved along its rows while the shutter was open.
GrayImage Blurred(GrayImage image, int reach_px) {
  const GrayImage sharp = image;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = reach_px; x + reach_px < image.width(); ++x) {
      int sum = 0;
      for (int k = -reach_px; k <= reach_px; ++k) sum += sharp.grey(y, x + k);
      image.grey(y, x) = static_cast<std::uint16_t>(sum / (2 * reach_px + 1));
    }
  }
  return image;
}

TEST_F(WheelReferenceOfAnArc, HoldsFramesViewsAndShape) {
  EXPECT_FALSE(reference_->closed);
  ASSERT_EQ(reference_->frames.size(), 10U);
  EXPECT_EQ(reference_->frames[4].status, WheelFrameStatus::kNotFound);
  EXPECT_TRUE(std::isnan(reference_->frames[4].angle_rad));
  EXPECT_NEAR(reference_->largest_angle_rad(), 54 * kDegrees, 0.01 * kDegrees);
  ASSERT_GE(reference_->views.size(), 4U);
  for (std::size_t v = 1; v < reference_->views.size(); ++v) {
    // Neighbours overlap by well over half of some 45 degrees.
    EXPECT_LT(reference_->views[v].angle_rad - reference_->views[v - 1].angle_rad, 19 * kDegrees);
  }
  int points = 0;
  for (const Eigen::Vector3d& p : reference_->views[1].point_mm.values()) {
    if (!p.allFinite()) continue;
    ++points;
    EXPECT_NEAR(std::hypot(p.x(), p.z()), 370, 16);
  }
  EXPECT_GT(points, 80);
  EXPECT_NEAR(reference_->profile.crown_radius_mm, wheel_->CrownRadius(), 0.06);
}

TEST_F(WheelReferenceOfAnArc, FindsFramesThatItIsMadeOfAndOthersBetween) {
  const WheelLibrary library(*reference_);
  for (const int f : {1, 4, 8}) {
    const WheelPlace place = library.Find(wheel_->Pair(f).left);
    ASSERT_TRUE(place.found) << place.why;
    EXPECT_NEAR(place.candidates[0].angle_rad, wheel_->Angle(f), 0.1 * kDegrees);
    EXPECT_GT(place.candidates[0].agreeing, 30);
  }
}

TEST_F(WheelReferenceOfAnArc, FindsTheLoadedWheel) {
  Scenario loaded = LiftedWheel::ScenarioOf(10, 6 * kDegrees);
  std::get<TyreOptions>(loaded.surface).lifted_mm = 0;
  loaded.seed = 9;
  LiftedWheel rolling(loaded);
  const WheelPlace place = WheelLibrary(*reference_).Find(rolling.Pair(3).left);
  ASSERT_TRUE(place.found) << place.why;
  EXPECT_NEAR(place.candidates[0].angle_rad, rolling.Angle(3), 3 * kDegrees);
}

TEST_F(WheelReferenceOfAnArc, NeverGuesses) {
  const WheelLibrary library(*reference_);
  Scenario other = LiftedWheel::ScenarioOf(10, 6 * kDegrees);
  other.speckle.seed += 1;
  LiftedWheel another(other);
  for (const int f : {0, 3, 7}) {
    const WheelPlace place = library.Find(another.Pair(f).left);
    EXPECT_FALSE(place.found);
    EXPECT_THAT(place.why, ::testing::Not(::testing::IsEmpty()));
    for (const WheelCandidate& c : place.candidates) EXPECT_LE(c.agreeing, 5);
  }
  EXPECT_FALSE(library.Find(Blurred(wheel_->Pair(3).left, 12)).found);
  EXPECT_FALSE(library.Find(testing::Wall(wheel_->rig())).found);
  EXPECT_THROW((void)library.Find({Image<std::uint16_t>({100, 80}, 3), 8}), InputError);
}

}  // namespace
}  // namespace plumbline
