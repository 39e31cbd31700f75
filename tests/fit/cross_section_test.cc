#include "fit/cross_section.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <functional>
#include <random>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr double kPitch_mm = 4;
const ImageSize kSize{31, 25};
const NeighbourCorrelation kIndependent = NeighbourCorrelation::OfOverlap(kSize, 5, 5, 1);
const NeighbourCorrelation kOverlapping = NeighbourCorrelation::OfOverlap(kSize, 5, 15, 1);

SurfacePoints Surface(const std::function<double(double, double)>& height_mm) {
  SurfacePoints surface;
  surface.point_mm = Image<Eigen::Vector3d>(kSize, Eigen::Vector3d::Zero());
  Eigen::Matrix<float, 6, 1> cov;
  cov << 4e-4F, 1e-4F, -2e-4F, 5e-4F, 3e-4F, 64e-4F;
  surface.cov_random_mm2 = Image<Eigen::Matrix<float, 6, 1>>(kSize, cov);
  for (int r = 0; r < kSize.height; ++r) {
    for (int c = 0; c < kSize.width; ++c) {
      // A grid that stands askew to the axes.
      const double x = kPitch_mm * (c - 15 + 0.15 * (r - 12)), y = kPitch_mm * (r - 12.3);
      surface.point_mm(r, c) = {x, y, height_mm(x, y)};
    }
  }
  return surface;
}

double Dome(double x, double y) { return 20 - (x * x + 2 * y * y) / 600; }

TEST(CrossSection, FollowsTheSurfaceInOrder) {
  const SurfacePoints dome = Surface(Dome);
  for (const double direction : {0.0, 0.7, 1.5707963267948966, 2.6}) {
    const CutPlane plane = CutPlane::Upright({3, -2}, direction);
    const auto line = CutSurface(dome, plane, kIndependent);
    ASSERT_GT(line.size(), 25U);
    for (std::size_t k = 0; k < line.size(); ++k) {
      const SectionPoint& p = line[k];
      ASSERT_FALSE(p.gap());
      EXPECT_NEAR(plane.normal.dot(p.position_mm), plane.offset_mm, 1e-9);
      EXPECT_EQ(p.along_mm, plane.along.dot(p.position_mm));
      EXPECT_NEAR(p.up_mm, p.position_mm.z(), 1e-9);
      if (k > 0) {
        EXPECT_GE(p.along_mm, line[k - 1].along_mm);
      }
      // Linear: below by curvature |d|^2 / 8 at most.
      const double above = Dome(p.position_mm.x(), p.position_mm.y());
      EXPECT_LE(p.up_mm, above + 1e-9);
      EXPECT_GE(p.up_mm, above - 0.02);
    }
  }
}

TEST(CrossSection, HasTheThesisPlanes) {
  const SurfacePoints dome = Surface(Dome);
  const auto lateral = CutSurface(dome, CutPlane::AtX(15), kIndependent);
  const auto longitudinal = CutSurface(dome, CutPlane::AtY(0), kIndependent);
  ASSERT_FALSE(lateral.empty());
  ASSERT_FALSE(longitudinal.empty());
  EXPECT_NEAR(lateral.front().position_mm.x(), 15, 1e-9);
  EXPECT_EQ(lateral.front().along_mm, lateral.front().position_mm.y());
  EXPECT_NEAR(longitudinal.back().position_mm.y(), 0, 1e-9);
  EXPECT_EQ(longitudinal.back().along_mm, longitudinal.back().position_mm.x());
  EXPECT_NEAR(longitudinal.back().up_mm, longitudinal.back().position_mm.z(), 1e-12);
  EXPECT_TRUE(CutSurface(dome, CutPlane::AtX(150), kIndependent).empty());
}

TEST(CrossSection, ClosesAroundAnIsland) {
  CutPlane level{Eigen::Vector3d::UnitZ(), 19, Eigen::Vector3d::UnitX()};
  const auto line = CutSurface(Surface(Dome), level, kIndependent);
  ASSERT_GT(line.size(), 10U);
  EXPECT_EQ(line.front().position_mm, line.back().position_mm);
  for (const SectionPoint& p : line) EXPECT_GE(p.along_mm, line.front().along_mm);
}

TEST(CrossSection, JoinsNothingOverAGap) {
  SurfacePoints holed = Surface(Dome);
  for (int r = 10; r <= 12; ++r) holed.point_mm(r, 14).setConstant(NAN);
  const auto line = CutSurface(holed, CutPlane::AtY(-4), kIndependent);
  int gaps = 0;
  for (std::size_t k = 0; k < line.size(); ++k) {
    if (line[k].gap()) {
      ++gaps;
      ASSERT_GT(k, 0U);
      ASSERT_LT(k + 1, line.size());
      EXPECT_GT(line[k + 1].along_mm - line[k - 1].along_mm, 1.5 * kPitch_mm);
    } else if (k > 0 && !line[k - 1].gap()) {
      EXPECT_LT(line[k].along_mm - line[k - 1].along_mm, 1.2 * kPitch_mm);
    }
  }
  EXPECT_EQ(gaps, 1);
}

TEST(CrossSection, RefusesAPlaneThatIsNone) {
  const SurfacePoints dome = Surface(Dome);
  CutPlane plane;
  plane.normal *= 2;
  EXPECT_THROW((void)CutSurface(dome, plane, kIndependent), UsageError);
  plane = {};
  plane.along = plane.normal;
  EXPECT_THROW((void)CutSurface(dome, plane, kIndependent), UsageError);
}

TEST(CrossSection, BandIsThatOfSampling) {
  // A slope across the cut, so that errors along it and across it count as well.
  const auto roof = [](double x, double y) { return 5 + 0.6 * x - 0.8 * y; };
  SurfacePoints flat = Surface(roof);
  flat.along_common_mm.emplace_back(kSize, Eigen::Vector3f(0, 0, 0.03F));
  flat.along_modes_mm.emplace_back(kSize, Eigen::Vector3f(0.02F, 0, 0.05F));
  flat.along_modes_mm.emplace_back(kSize, Eigen::Vector3f(0, 0.04F, 0));
  Eigen::Matrix3d cov;
  cov << 4e-4, 1e-4, -2e-4, 1e-4, 5e-4, 3e-4, -2e-4, 3e-4, 64e-4;
  const Eigen::Matrix3d root = cov.llt().matrixL();
  const CutPlane plane = CutPlane::AtX(9.3);
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  const auto three = [&] {
    const double a = normal(random), b = normal(random), c = normal(random);
    return Eigen::Vector3d(a, b, c);
  };
  for (const bool overlapping : {false, true}) {
    double squares = 0, calibration = 0;
    int count = 0, covered = 0;
    constexpr int kDraws = 300;
    for (int draw = 0; draw < kDraws; ++draw) {
      SurfacePoints noisy = flat;
      const Eigen::Vector3d shift(0, 0, 0.03 * normal(random));
      const int window = overlapping ? 3 : 1;
      Image<Eigen::Vector3d> white({kSize.width + 2, kSize.height + 2}, Eigen::Vector3d::Zero());
      for (Eigen::Vector3d& w : white.values()) w = three();
      for (int r = 0; r < kSize.height; ++r) {
        for (int c = 0; c < kSize.width; ++c) {
          Eigen::Vector3d e = Eigen::Vector3d::Zero();
          for (int i = 0; i < window * window; ++i) {
            e += white(r + i / window, c + i % window) / window;
          }
          noisy.point_mm(r, c) += root * e + shift;
        }
      }
      const auto line = CutSurface(noisy, plane, overlapping ? kOverlapping : kIndependent);
      // One point in the middle of each: others are correlated with it.
      const std::size_t k = line.size() / 2;
      const double error =
          (line[k].up_mm - roof(line[k].position_mm.x(), line[k].position_mm.y())) /
          std::hypot(1, 0.8);
      squares += std::pow(error / line[k].sigma_random_mm, 2);
      covered += std::abs(error) < 1.96 * line[k].sigma_random_mm ? 1 : 0;
      calibration += line[k].sigma_calibration_mm / kDraws;
      ++count;
    }
    EXPECT_NEAR(squares / count, 1, 4 * std::sqrt(2.0 / count));
    EXPECT_NEAR(covered / static_cast<double>(count), 0.95, 0.04);
    // Mode 1 lifts by 0.05 - 0.6 * 0.02, mode 2 by 0.8 * 0.04.
    EXPECT_NEAR(calibration, std::hypot(0.038, 0.032) / std::hypot(1, 0.8), 0.001);
  }
}

}  // namespace
}  // namespace plumbline
