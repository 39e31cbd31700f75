#include "fit/bump.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "calib/error.h"

namespace plumbline {
namespace {

const ImageSize kSize{41, 35};
constexpr double kPitch_mm = 5, kThickness_mm = 20, kSigma_mm = 0.05;
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
  const Image<double> thickness(kSize, kThickness_mm);
  const Eigen::Vector2d at(12, -9);
  const BumpOptions options{.top_radius_mm = 0};
  const auto exact = FindBumps(Surface(Ground(at, 5)), thickness, kIndependent, options);
  ASSERT_EQ(exact.size(), 1U);
  EXPECT_NEAR(exact[0].height_mm.value, 5, 0.2);
  EXPECT_NEAR(exact[0].clearance_mm.value, 5, 0.2);
  EXPECT_LT((exact[0].at_mm - at).norm(), 0.5);
  EXPECT_NEAR(exact[0].width_mm, 2 * std::sqrt(200 * std::log(2)), 4);
  double squares = 0;
  constexpr int kDraws = 100;
  for (int draw = 0; draw < kDraws; ++draw) {
    const auto bumps = FindBumps(Surface(Ground(at, 5), &random), thickness, kIndependent, options);
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
  const Image<double> thickness(kSize, kThickness_mm);
  EXPECT_TRUE(FindBumps(Surface(Ground({0, 0}, 0), &random), thickness, kIndependent).empty());
  // At the end of what is seen: it may go on.
  EXPECT_TRUE(FindBumps(Surface(Ground({0, 85}, 9)), thickness, kIndependent).empty());
  SurfacePoints holed = Surface(Ground({12, -9}, 5));
  holed.point_mm(19, 22).setConstant(NAN);
  EXPECT_TRUE(FindBumps(holed, thickness, kIndependent).empty());
  EXPECT_EQ(FindBumps(Surface(Ground({12, -9}, 5)), thickness, kIndependent).size(), 1U);
}

TEST(Bump, RefusesBadOptions) {
  const SurfacePoints flat = Surface(Ground({0, 0}, 0));
  const Image<double> thickness(kSize, kThickness_mm);
  EXPECT_THROW((void)FindBumps(flat, thickness, kIndependent, {.least_height_mm = 0}), UsageError);
  EXPECT_THROW((void)FindBumps(flat, thickness, kIndependent, {.flat_mm = 3}), UsageError);
  EXPECT_THROW((void)FindBumps(flat, Image<double>({2, 2}), kIndependent), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
