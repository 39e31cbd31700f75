#include "fit/bump.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "calib/error.h"
#include "tests/fit/askew_surface.h"

namespace plumbline {
namespace {

using testing::AskewSurface;
using testing::kAskewNeighbours;
using testing::kAskewSigma_mm;

constexpr double kThickness_mm = 20;

using Height = std::function<double(double, double)>;

// A bump of a bell's shape on ground that lifts off beyond 70 mm, with a rise at the edge that is
// no bump.
Height Ground(const Eigen::Vector2d& at_mm, double height_mm) {
  return [=](double x, double y) {
    const double far = std::max(0.0, std::hypot(x, y) - 70);
    const double near = std::hypot(x - at_mm.x(), y - at_mm.y());
    return kThickness_mm + 0.02 * far * far + height_mm * std::exp(-near * near / 200);
  };
}

TEST(Bump, IsFoundWithItsSigma) {
  std::mt19937 random(12);
  const Image<double> thickness(testing::kAskewSize, kThickness_mm);
  const Eigen::Vector2d at(12, -9);
  const BumpOptions options{.top_radius_mm = 0};
  const auto exact = FindBumps(AskewSurface(Ground(at, 5)), thickness, kAskewNeighbours, options);
  ASSERT_EQ(exact.size(), 1U);
  EXPECT_NEAR(exact[0].height_mm.value, 5, 0.2);
  EXPECT_NEAR(exact[0].clearance_mm.value, 5, 0.2);
  EXPECT_LT((exact[0].at_mm - at).norm(), 0.5);
  EXPECT_NEAR(exact[0].width_mm, 2 * std::sqrt(200 * std::log(2)), 4);
  double squares = 0;
  constexpr int kDraws = 100;
  for (int draw = 0; draw < kDraws; ++draw) {
    const auto bumps =
        FindBumps(AskewSurface(Ground(at, 5), &random), thickness, kAskewNeighbours, options);
    ASSERT_EQ(bumps.size(), 1U);
    squares += std::pow((bumps[0].height_mm.value - exact[0].height_mm.value) /
                            bumps[0].height_mm.sigma_random,
                        2) /
               kDraws;
  }
  EXPECT_NEAR(squares, 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(Bump, IsNotWhereTheGroundIsFlatOrTheTyreLiftsOff) {
  std::mt19937 random(13);
  const Image<double> thickness(testing::kAskewSize, kThickness_mm);
  EXPECT_TRUE(
      FindBumps(AskewSurface(Ground({0, 0}, 0), &random), thickness, kAskewNeighbours).empty());
  // At the end of what is seen: it may go on.
  EXPECT_TRUE(FindBumps(AskewSurface(Ground({0, 85}, 9)), thickness, kAskewNeighbours).empty());
  EXPECT_EQ(FindBumps(AskewSurface(Ground({12, -9}, 5)), thickness, kAskewNeighbours).size(), 1U);
}

TEST(Bump, MayLackSomeOfItsPoints) {
  const Image<double> thickness(testing::kAskewSize, kThickness_mm);
  SurfacePoints holed = AskewSurface(Ground({12, -9}, 5));
  const auto whole = FindBumps(holed, thickness, kAskewNeighbours);
  holed.point_mm(19, 24).setConstant(NAN);  // on its flank
  const auto found = FindBumps(holed, thickness, kAskewNeighbours);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(found[0].height_mm.value, whole[0].height_mm.value, 0.1);
  EXPECT_NEAR(found[0].width_mm, whole[0].width_mm, 3);
  for (int r = 18; r <= 20; ++r) {
    for (int c = 22; c <= 24; ++c) holed.point_mm(r, c).setConstant(NAN);
  }
  EXPECT_TRUE(FindBumps(holed, thickness, kAskewNeighbours).empty());
}

// The ground's height is off by 3 mm, and said to be so unsure.
TEST(Bump, HasItsHeightWhereThatOfTheGroundIsHardlyKnown) {
  const Image<double> thickness(testing::kAskewSize, kThickness_mm);
  SurfacePoints off = AskewSurface(Ground({12, -9}, 9));
  const auto level = FindBumps(off, thickness, kAskewNeighbours);
  for (Eigen::Vector3d& p : off.point_mm.values()) p.z() -= 3;
  off.along_common_mm.assign(1, Image<Eigen::Vector3f>(off.size(), Eigen::Vector3f(0, 0, 2)));
  const auto found = FindBumps(off, thickness, kAskewNeighbours);
  ASSERT_EQ(found.size(), 1U);
  ASSERT_EQ(level.size(), 1U);
  EXPECT_NEAR(found[0].height_mm.value, level[0].height_mm.value, 0.1);
  EXPECT_LT(found[0].height_mm.sigma_random, 0.1);
  EXPECT_GT(found[0].clearance_mm.sigma_random, 1.9);
}

TEST(Bump, RefusesBadOptions) {
  const SurfacePoints flat = AskewSurface(Ground({0, 0}, 0));
  const Image<double> thickness(testing::kAskewSize, kThickness_mm);
  EXPECT_THROW((void)FindBumps(flat, thickness, kAskewNeighbours, {.least_height_mm = 0}),
               UsageError);
  EXPECT_THROW((void)FindBumps(flat, thickness, kAskewNeighbours, {.flat_mm = 3}), UsageError);
  EXPECT_THROW((void)FindBumps(flat, Image<double>({2, 2}), kAskewNeighbours),
               std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
