#include "fit/height_map.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "calib/error.h"

namespace plumbline {
namespace {

const ImageSize kSize{41, 35};
constexpr double kPitch_mm = 5, kSigma_mm = 0.05;
const NeighbourCorrelation kIndependent = NeighbourCorrelation::OfOverlap(kSize, 5, 5, 1);

using Height = std::function<double(double, double)>;

// A grid that stands askew to the axes. Noise along z alone.
SurfacePoints Surface(const Height& height_mm, std::mt19937* random = nullptr) {
  std::normal_distribution<double> normal(0, kSigma_mm);
  SurfacePoints surface;
  surface.point_mm = Image<Eigen::Vector3d>(kSize, Eigen::Vector3d::Zero());
  Eigen::Matrix<float, 6, 1> cov = Eigen::Matrix<float, 6, 1>::Zero();
  cov[5] = static_cast<float>(kSigma_mm * kSigma_mm);
  surface.cov_random_mm2 = Image<Eigen::Matrix<float, 6, 1>>(kSize, cov);
  for (int r = 0; r < kSize.height; ++r) {
    for (int c = 0; c < kSize.width; ++c) {
      const double x = kPitch_mm * (c - 20 + 0.1 * (r - 17)), y = kPitch_mm * (17 - r);
      surface.point_mm(r, c) = {x, y, height_mm(x, y) + (random != nullptr ? normal(*random) : 0)};
    }
  }
  return surface;
}

double Roof(double x, double y) { return 30 + 0.2 * x - 0.1 * y; }

TEST(HeightMap, IsExactOnAPlane) {
  const SurfacePoints roof = Surface(Roof);
  const GroundGrid grid = GridAround(roof, 3);
  EXPECT_EQ(std::fmod(grid.first_mm.x(), 3), 0);
  const HeightMap map = HeightsOf(roof, grid, kIndependent);
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
  SurfacePoints roof = Surface(Roof);
  roof.point_mm(17, 20).setConstant(NAN);
  const GroundGrid grid{{-40, -40}, 1, {81, 81}};
  const HeightMap map = HeightsOf(roof, grid, kIndependent);
  int gaps = 0;
  for (const double h : map.height_mm.values()) gaps += std::isnan(h) ? 1 : 0;
  EXPECT_NEAR(gaps, 4 * 25, 25);  // its four cells
  EXPECT_TRUE(std::isnan(map.height_mm(40, 40)));
  EXPECT_TRUE(std::isnan(map.sigma_random_mm(40, 40)));
}

TEST(HeightMap, TakesTheLowerOfTwoSheets) {
  // The second half of the columns lies over the first.
  SurfacePoints folded = Surface(Roof);
  for (int r = 0; r < kSize.height; ++r) {
    for (int c = 0; c < kSize.width; ++c) {
      folded.point_mm(r, c) = {kPitch_mm * std::min(c, kSize.width - c), kPitch_mm * r,
                               c < kSize.width / 2 ? 20.0 : 50.0};
    }
  }
  const HeightMap map = HeightsOf(folded, {{10, 10}, 5, {10, 10}}, kIndependent);
  for (const double h : map.height_mm.values()) EXPECT_NEAR(h, 20, 1e-9);
}

TEST(HeightMap, DifferenceHasBothErrors) {
  std::mt19937 random(3);
  const GroundGrid grid{{-60, -60}, 17, {8, 8}};
  double squares = 0;
  int count = 0;
  HeightDifference difference;
  for (int draw = 0; draw < 60; ++draw) {
    SurfacePoints now = Surface(Roof, &random), before = Surface(Roof, &random);
    for (SurfacePoints* s : {&now, &before}) {
      s->along_modes_mm.emplace_back(kSize, Eigen::Vector3f(0, 0, s == &now ? 0.3F : 0.1F));
    }
    difference = CompareHeights(HeightsOf(now, grid, kIndependent),
                                HeightsOf(before, grid, kIndependent), draw % 2 == 0);
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
  const SurfacePoints roof = Surface(Roof);
  EXPECT_THROW((void)GridAround(roof, 0), UsageError);
  const HeightMap one = HeightsOf(roof, {{0, 0}, 1, {4, 4}}, kIndependent);
  const HeightMap other = HeightsOf(roof, {{0, 0}, 1, {4, 5}}, kIndependent);
  EXPECT_THROW((void)CompareHeights(one, other, true), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
