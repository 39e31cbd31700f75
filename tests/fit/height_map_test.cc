#include "fit/height_map.h"

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

double Roof(double x, double y) { return 30 + 0.2 * x - 0.1 * y; }

TEST(HeightMap, IsExactOnAPlane) {
  const SurfacePoints roof = AskewSurface(Roof);
  const GroundGrid grid = GridAround(roof, 3);
  EXPECT_EQ(std::fmod(grid.first_mm.x(), 3), 0);
  const HeightMap map = HeightsOf(roof, grid, kAskewNeighbours);
  int known = 0;
  for (int r = 0; r < grid.size.height; ++r) {
    for (int c = 0; c < grid.size.width; ++c) {
      if (std::isnan(map.height_mm(r, c))) continue;
      const Eigen::Vector2d at = grid.At(r, c);
      EXPECT_NEAR(map.height_mm(r, c), Roof(at.x(), at.y()), 1e-9);
      ++known;
    }
  }
  // All places within the outline: 200 mm by 170 mm.
  EXPECT_NEAR(known, 200 * 170 / 9.0, 120);
}

TEST(HeightMap, FillsNoGap) {
  SurfacePoints roof = AskewSurface(Roof);
  roof.point_mm(17, 20).setConstant(NAN);
  const GroundGrid grid{{-40, -40}, 1, {81, 81}};
  const HeightMap map = HeightsOf(roof, grid, kAskewNeighbours);
  int gaps = 0;
  for (const double h : map.height_mm.values()) gaps += std::isnan(h) ? 1 : 0;
  EXPECT_NEAR(gaps, 4 * 25, 25);  // its four cells
  EXPECT_TRUE(std::isnan(map.height_mm(40, 40)));
  EXPECT_TRUE(std::isnan(map.sigma_random_mm(40, 40)));
}

TEST(HeightMap, TakesTheLowerOfTwoSheets) {
  // The second half of the columns lies over the first.
  SurfacePoints folded = AskewSurface(Roof);
  for (int r = 0; r < testing::kAskewSize.height; ++r) {
    for (int c = 0; c < testing::kAskewSize.width; ++c) {
      folded.point_mm(r, c) = {testing::kAskewPitch_mm * std::min(c, testing::kAskewSize.width - c),
                               testing::kAskewPitch_mm * r,
                               c < testing::kAskewSize.width / 2 ? 20.0 : 50.0};
    }
  }
  const HeightMap map = HeightsOf(folded, {{10, 10}, 5, {10, 10}}, kAskewNeighbours);
  for (const double h : map.height_mm.values()) EXPECT_NEAR(h, 20, 1e-9);
}

TEST(HeightMap, DifferenceHasBothErrors) {
  std::mt19937 random(3);
  const GroundGrid grid{{-60, -60}, 17, {8, 8}};
  double squares = 0;
  int count = 0;
  HeightDifference difference;
  for (int draw = 0; draw < 60; ++draw) {
    SurfacePoints now = AskewSurface(Roof, &random), before = AskewSurface(Roof, &random);
    for (SurfacePoints* s : {&now, &before}) {
      s->along_modes_mm.emplace_back(testing::kAskewSize,
                                     Eigen::Vector3f(0, 0, s == &now ? 0.3F : 0.1F));
    }
    difference = CompareHeights(HeightsOf(now, grid, kAskewNeighbours),
                                HeightsOf(before, grid, kAskewNeighbours), draw % 2 == 0);
    for (std::size_t i = 0; i < difference.value_mm.pixel_count(); ++i) {
      squares += std::pow(
          difference.value_mm.data()[i] / static_cast<double>(difference.sigma_random_mm.data()[i]),
          2);
      ++count;
      EXPECT_NEAR(difference.sigma_calibration_mm.data()[i],
                  draw % 2 == 0 ? 0.2 : std::hypot(0.3, 0.1), 1e-6);
    }
  }
  EXPECT_EQ(difference.count, 64);
  EXPECT_NEAR(squares / count, 1, 0.1);
}

TEST(HeightMap, RefusesWhatDoesNotFit) {
  const SurfacePoints roof = AskewSurface(Roof);
  EXPECT_THROW((void)GridAround(roof, 0), UsageError);
  const HeightMap one = HeightsOf(roof, {{0, 0}, 1, {4, 4}}, kAskewNeighbours);
  const HeightMap other = HeightsOf(roof, {{0, 0}, 1, {4, 5}}, kAskewNeighbours);
  EXPECT_THROW((void)CompareHeights(one, other, true), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
