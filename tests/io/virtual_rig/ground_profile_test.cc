#include "io/virtual_rig/internal/ground_profile.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "calib/error.h"

namespace plumbline {
namespace {

using internal::GroundProfile;
using Section = Obstacle::Section;

constexpr double kDegree = std::numbers::pi / 180;

// Everything that the scenarios roll over.
std::vector<Obstacle> Obstacles() {
  std::vector<Obstacle> obstacles;
  for (const double angle : {0.0, 45 * kDegree, 90 * kDegree}) {
    obstacles.push_back({Section::kSquare, 38, 0, {3, -2}, angle});
    obstacles.push_back({Section::kSquare, 50, 0, {0, 45}, angle});
    obstacles.push_back({Section::kAngleIron, 40, 0, {0, 0}, angle});
  }
  const double heights_mm[] = {23.1, 19.6, 13.6, 10.0}, flats_mm[] = {36, 30, 21, 17};
  for (int k = 0; k < 4; ++k) {
    obstacles.push_back({Section::kNut, flats_mm[k], heights_mm[k], {5, 1}, 0.2});
  }
  return obstacles;
}

TEST(GroundProfile, EnvelopeIsNeverBelowTheGround) {
  for (const Obstacle& obstacle : Obstacles()) {
    for (const double bending_length_mm : {15.0, 30.0, 80.0}) {
      const GroundProfile ground({obstacle}, bending_length_mm);
      double highest = 0;
      for (double x = -130; x <= 130; x += 1.7) {
        for (double y = -130; y <= 130; y += 1.9) {
          const double enveloped = ground.Enveloped(x, y);
          ASSERT_GE(enveloped, ground.Height({x, y})) << x << " " << y;
          highest = std::max(highest, enveloped);
        }
      }
      EXPECT_NEAR(highest, obstacle.Height(), 1e-9);
    }
  }
}

TEST(GroundProfile, ObstaclesAreAsHighAndWideAsTheyAreMadeOf) {
  const auto height = [](const Obstacle& obstacle, double x, double y) {
    return GroundProfile({obstacle}).Height({x, y});
  };
  const Obstacle bar{Section::kSquare, 38, 0, {0, 0}, 0};
  EXPECT_EQ(height(bar, 18.9, 500), 38);
  EXPECT_EQ(height(bar, 19.1, 0), 0);
  // On its hypotenuse: 45 degrees on both sides, blunt on top over 2 mm each way.
  const Obstacle iron{Section::kAngleIron, 40, 0, {0, 0}, 0};
  EXPECT_NEAR(height(iron, 0, 0), 40 / std::sqrt(2) - 2, 1e-12);
  EXPECT_NEAR(height(iron, 10, 0) - height(iron, 20, 0), 10, 1e-12);
  EXPECT_EQ(height(iron, 28.3, 0), 0);
  // 45 degrees: along the bar nothing changes.
  const Obstacle diagonal{Section::kSquare, 50, 0, {0, 0}, 45 * kDegree};
  EXPECT_EQ(height(diagonal, -70, 70), 50);
  EXPECT_EQ(height(diagonal, 30, 30), 0);
  // A hexagon: 36 mm across its flats, 41.57 mm across its corners.
  const Obstacle nut{Section::kNut, 36, 23.1, {0, 0}, 0};
  EXPECT_EQ(height(nut, 17.9, 0), 23.1);
  EXPECT_EQ(height(nut, 18.1, 0), 0);
  EXPECT_EQ(height(nut, 0, 20.7), 23.1);
  EXPECT_EQ(height(nut, 0, 20.9), 0);
}

// A carcass of bending length l rises to a height h over 2 sqrt(h l), beside the obstacle.
TEST(GroundProfile, FlanksAreAsLongAsTheBendingLengthAsks) {
  for (const double bending_length_mm : {15.0, 30.0, 60.0}) {
    const GroundProfile ground({{Section::kSquare, 38, 0, {0, 0}, 0}}, bending_length_mm);
    const double flank = 2 * std::sqrt(38 * bending_length_mm);
    EXPECT_EQ(ground.Enveloped(19.0, 7.0), 38);
    EXPECT_NEAR(ground.Enveloped(19 + flank / 2, 7.0), 19, 1e-9);
    EXPECT_GT(ground.Enveloped(19 + 0.98 * flank, 7.0), 0);
    EXPECT_EQ(ground.Enveloped(19 + flank, 7.0), 0);
    // It hangs free between the bar's edge and the foot of the flank, and nowhere else.
    EXPECT_LT(ground.Bridging({18, 7}), 0);
    EXPECT_GT(ground.Bridging({19 + flank / 2, 7}), 0);
    EXPECT_LT(ground.Bridging({20 + flank, 7}), 0);
  }
}

TEST(GroundProfile, RefusesObstaclesThatTheTyreWouldTouchTogether) {
  const Obstacle bar{Section::kSquare, 38, 0, {0, 0}, 0};
  Obstacle other = bar;
  other.centre_mm.x() = 120;
  EXPECT_THROW(GroundProfile({bar, other}), UsageError);
  other.centre_mm.x() = 180;
  EXPECT_NO_THROW(GroundProfile({bar, other}));
  other.angle_rad = 0.1;  // they meet somewhere
  EXPECT_THROW(GroundProfile({bar, other}), UsageError);
}

}  // namespace
}  // namespace plumbline
