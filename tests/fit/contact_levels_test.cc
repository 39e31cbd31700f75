#include "fit/contact_levels.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>
#include <string>

#include "calib/error.h"
#include "fit/carcass_thickness.h"
#include "tests/support/tyre_frames.h"

namespace plumbline {
namespace {

using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

std::optional<ContactLevels> Find(const TyreFrame& frame, std::string* why = nullptr) {
  return FindContactLevels(frame.point_mm, frame.cov_mm2, frame.thickness_mm, frame.axis, nullptr,
                           {}, why);
}

TyreFrame Frame(const char* scenario, int frame, double sigma_mm) {
  const VirtualRig rig(TyreScenario(scenario, {0.8, -1.5, 0.4}));
  std::mt19937 random(1);
  return WithNoise(TrueTyreFrame(rig, frame, 10), sigma_mm, 1, random);
}

TEST(ContactLevels, TheTopOfABarIsParallelToTheGround) {
  struct Case {
    const char* scenario;
    int frame;
    double height_mm;
  };
  for (const Case& c :
       {Case{"cleat-longitudinal-square38", 0, 38}, Case{"cleat-longitudinal-square50", 0, 50},
        Case{"cleat-offset-square50", 0, 50}, Case{"cleat-diagonal-square38", 5, 38},
        Case{"cleat-lateral-square50", 6, 50}}) {
    const TyreFrame frame = Frame(c.scenario, c.frame, 1e-4);
    const auto levels = Find(frame);
    ASSERT_TRUE(levels.has_value()) << c.scenario;
    EXPECT_FALSE(levels->on_ground) << c.scenario;
    EXPECT_GT(levels->below_share, 0.4) << c.scenario;
    ASSERT_EQ(levels->parts.size(), 1U) << c.scenario;
    const GroundPlane& top = levels->parts.front();
    EXPECT_LT((top.normal - frame.Ground().normal).norm(), 1e-4) << c.scenario;
    EXPECT_NEAR(frame.Ground().SignedDistance(top.centroid), c.height_mm, 5e-3) << c.scenario;
  }
}

TEST(ContactLevels, FindGroundAndTopSideBySide) {
  const TyreFrame frame = Frame("cleat-diagonal-square38", 9, 0.01);
  const auto levels = Find(frame);
  ASSERT_TRUE(levels.has_value());
  EXPECT_TRUE(levels->on_ground);
  ASSERT_EQ(levels->parts.size(), 2U);
  const ParallelPlanes planes = MakeParallel(levels->parts);
  EXPECT_LT((planes.planes[0].normal - frame.Ground().normal).norm(), 5e-4);
  EXPECT_NEAR(frame.Ground().SignedDistance(planes.planes[0].centroid), 0, 0.03);
  EXPECT_NEAR(planes.planes[0].SignedDistance(planes.planes[1].centroid), 38, 0.05);
}

TEST(ContactLevels, AGroundThatIsGivenStaysAsItIs) {
  const TyreFrame frame = Frame("cleat-lateral-square38", 2, 0.01);
  const auto flat =
      FindFlatContact(frame.point_mm, frame.cov_mm2, frame.thickness_mm, frame.axis, {});
  ASSERT_TRUE(flat.has_value());
  const auto levels = FindContactLevels(frame.point_mm, frame.cov_mm2, frame.thickness_mm,
                                        frame.axis, &flat->plane);
  ASSERT_TRUE(levels.has_value());
  EXPECT_TRUE(levels->on_ground);
  ASSERT_EQ(levels->parts.size(), 2U);
  EXPECT_EQ(levels->at_other_edge[0], flat->plane.inlier);
  const ParallelPlanes planes = MakeParallel(levels->parts, NormalOf::kFirst);
  EXPECT_LT((planes.planes[0].normal - flat->plane.normal).norm(), 1e-9);
  EXPECT_LT((planes.planes[0].cov - flat->plane.cov).norm(), 1e-6 * flat->plane.cov.norm());
  EXPECT_NEAR(planes.planes[0].SignedDistance(planes.planes[1].centroid), 38, 0.1);
}

TEST(ContactLevels, SayWhyThereAreNone) {
  // Free; on the ridge of an angle iron.
  for (const char* scenario : {"tyre-lifted", "cleat-longitudinal-angle40"}) {
    std::string why;
    EXPECT_FALSE(Find(Frame(scenario, 0, 0.02), &why).has_value()) << scenario;
    EXPECT_FALSE(why.empty()) << scenario;
  }
  TyreFrame nothing;
  nothing.point_mm = Image<Eigen::Vector3d>({4, 4}, Eigen::Vector3d::Constant(NAN));
  nothing.cov_mm2 = Image<Eigen::Matrix3d>({4, 4}, Eigen::Matrix3d::Identity());
  nothing.thickness_mm = Image<double>({4, 4}, 20);
  std::string why;
  EXPECT_FALSE(Find(nothing, &why).has_value());
  EXPECT_NE(why.find("0 points"), std::string::npos);
  EXPECT_THROW((void)FindContactLevels(nothing.point_mm, nothing.cov_mm2, nothing.thickness_mm,
                                       nothing.axis, nullptr, {.edge_mm = 0}),
               UsageError);
  nothing.thickness_mm = Image<double>({3, 4}, 20);
  EXPECT_THROW((void)Find(nothing), std::invalid_argument);
  EXPECT_THROW((void)MakeParallel({}), std::invalid_argument);
}

// Ground 200 mm below the camera, and on it a plank along x with slopes beside it.
struct Plank {
  Image<Eigen::Vector3d> point_mm;
  Image<Eigen::Matrix3d> cov_mm2;
  Image<double> thickness_mm;
  WheelAxis axis = WheelAxis::Through({0, 0, -200}, {0, -1, 0});
};

Plank MakePlank(double tilt_rad, double sigma_mm, std::mt19937& random) {
  const ImageSize size{60, 44};
  Plank plank{Image<Eigen::Vector3d>(size, Eigen::Vector3d::Zero()),
              Image<Eigen::Matrix3d>(size, sigma_mm * sigma_mm * Eigen::Matrix3d::Identity()),
              Image<double>(size, 0)};
  std::normal_distribution<double> normal(0, sigma_mm);
  for (int r = 0; r < size.height; ++r) {
    for (int c = 0; c < size.width; ++c) {
      const double x = 4 * (c - 29.5), y = 4 * (r - 21.5);
      const double beside = std::max(0.0, std::abs(y) - 26);
      const double height = std::abs(y) < 26 ? 30 + tilt_rad * y : std::max(0.0, 30 - 3 * beside);
      plank.point_mm(r, c) = Eigen::Vector3d(x, y, 200 - height + normal(random));
    }
  }
  return plank;
}

TEST(ContactLevels, CovarianceIsThatOfSampling) {
  std::mt19937 random(2);
  double nees = 0;
  constexpr int kDraws = 60;
  for (int draw = 0; draw < kDraws; ++draw) {
    const Plank plank = MakePlank(0, 0.03, random);
    const auto levels =
        FindContactLevels(plank.point_mm, plank.cov_mm2, plank.thickness_mm, plank.axis, nullptr);
    ASSERT_TRUE(levels.has_value());
    ASSERT_EQ(levels->parts.size(), 2U);
    const ParallelPlanes planes = MakeParallel(levels->parts);
    GroundPlane truth = planes.planes[0];
    truth.normal = Eigen::Vector3d(0, 0, -1);
    truth.offset_mm = -200;
    Eigen::Vector4d error;
    error << PlaneDifference(planes.planes[0], truth).head<2>(),
        planes.planes[0].centroid.z() - 200, planes.planes[1].centroid.z() - 170;
    nees += error.dot(planes.cov.ldlt().solve(error)) / kDraws;
  }
  EXPECT_NEAR(nees, 4, 4 * std::sqrt(8.0 / kDraws));
}

TEST(ContactLevels, WhatIsNotParallelIsLeftOut) {
  std::mt19937 random(3);
  for (const double tilt_rad : {0.0, 4e-3}) {
    const Plank plank = MakePlank(tilt_rad, 0.01, random);
    const auto levels =
        FindContactLevels(plank.point_mm, plank.cov_mm2, plank.thickness_mm, plank.axis, nullptr);
    ASSERT_TRUE(levels.has_value());
    EXPECT_EQ(levels->parts.size(), tilt_rad > 0 ? 1U : 2U);
  }
}

TEST(ContactLevels, PartsFollowTheirPoints) {
  std::mt19937 random(4);
  const Plank plank = MakePlank(0, 0.01, random);
  const auto levels =
      FindContactLevels(plank.point_mm, plank.cov_mm2, plank.thickness_mm, plank.axis, nullptr);
  ASSERT_TRUE(levels.has_value());
  const Rigid3 moved = Rigid3::FromRotationVector({2e-3, -1e-3, 5e-4}, {0.1, 0.2, -0.3});
  Image<Eigen::Vector3d> points = plank.point_mm;
  for (Eigen::Vector3d& point : points.values()) point = moved * point;
  const auto parts = RefitParts(levels->parts, points, plank.cov_mm2, plank.thickness_mm);
  for (std::size_t k = 0; k < parts.size(); ++k) {
    const GroundPlane& before = levels->parts[k];
    EXPECT_LT((parts[k].normal - moved.rotation * before.normal).norm(), 2e-6);
    EXPECT_LT(std::abs(parts[k].SignedDistance(moved * before.centroid)), 1e-3);
    EXPECT_EQ(parts[k].cov, before.cov);
  }
}

}  // namespace
}  // namespace plumbline
