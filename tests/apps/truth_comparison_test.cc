#include "apps/truth_comparison.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "io/virtual_rig/truth_series.h"

namespace plumbline {
namespace {

// The truth as if it had been measured, with errors of a known size along z.
struct Measured {
  VirtualRig rig;
  SeriesFrame frame;
  Image<Eigen::Vector2f> grid_px;

  explicit Measured(double error_mm, double claimed_mm) : rig(MakeScenario("tyre-flat")) {
    const TruthSeries truth(rig);
    frame = truth.Frame(0);
    grid_px = truth.Header().grid_px;
    std::mt19937 random(5);
    std::normal_distribution<float> normal(0, static_cast<float>(error_mm));
    for (std::size_t i = 0; i < frame.surface.status.pixel_count(); ++i) {
      if (frame.surface.status.data()[i] != Status::kOk) continue;
      frame.surface.position_mm.data()[i].z() += normal(random);
      frame.surface.sigma_random_mm.data()[i].setConstant(static_cast<float>(claimed_mm));
    }
  }

  TruthComparison Compare() const { return CompareWithTruth(frame, grid_px, *rig.Truth(0)); }
};

TEST(TruthComparison, FindsTheErrorsThatWereMade) {
  const TruthComparison comparison = Measured(0.05, 0.05).Compare();
  EXPECT_GT(comparison.points, 3500);
  EXPECT_EQ(comparison.unfounded, 0);
  EXPECT_NEAR(comparison.rms_distance_mm, 0.05, 0.002);
  EXPECT_NEAR(comparison.rms_height_mm, 0.05, 0.002);
  EXPECT_NEAR(comparison.median_height_error_mm, 0.6745 * 0.05, 0.002);
  EXPECT_NEAR(comparison.within_one_sigma, 0.683, 0.03);
  EXPECT_NEAR(comparison.within_two_sigma, 0.954, 0.02);
  EXPECT_LT(comparison.tilt_error_rad.norm(), 1e-12);
}

TEST(TruthComparison, TellsAClaimThatIsTooSmall) {
  EXPECT_LT(Measured(0.05, 0.01).Compare().within_two_sigma, 0.4);
}

TEST(TruthComparison, TakesOutTheRigidMotionForTheShapeOnly) {
  Measured measured(0.01, 0.01);
  for (Eigen::Vector3f& p : measured.frame.surface.position_mm.values()) {
    p += Eigen::Vector3f(0.3f, 0, -0.4f);
  }
  const TruthComparison comparison = measured.Compare();
  EXPECT_NEAR(comparison.rms_distance_mm, 0.5, 0.01);
  EXPECT_NEAR(comparison.rms_shape_mm, 0.01, 0.002);
}

TEST(TruthComparison, FindsTheErrorOfTheDisplacementAboutTheWheel) {
  Measured measured(1e-9, 0.01);
  const TruthComparison exact = measured.Compare();
  EXPECT_LT(exact.rms_displacement_mm.norm(), 1e-4);
  const auto axis = measured.frame.wheel.axis.cast<float>();
  for (Eigen::Vector3f& u : measured.frame.displacement.value_mm.values()) {
    u += 0.03F * axis + Eigen::Vector3f(0, 0, 0.1F);  // upwards: towards the axis at the bottom
  }
  const TruthComparison off = measured.Compare();
  EXPECT_NEAR(off.rms_displacement_mm.norm(), std::hypot(0.03, 0.1), 1e-3);
  EXPECT_NEAR(off.rms_displacement_mm.z(), 0.03, 1e-3);
  EXPECT_GT(off.rms_displacement_mm.x(), 0.09);
  EXPECT_GT(off.median_displacement_error_mm.x(), 0.09);
  EXPECT_LT(off.rms_displacement_mm.y(), 0.05);
}

TEST(TruthComparison, TellsHowOftenDisplacementsAreWithinTheirSigmas) {
  Measured measured(1e-9, 0.01);
  std::mt19937 random(6);
  std::normal_distribution<float> normal;
  const auto axis = measured.frame.wheel.axis.cast<float>();
  for (std::size_t i = 0; i < measured.frame.displacement.value_mm.pixel_count(); ++i) {
    // Along the axis three times what is claimed, about it as much.
    measured.frame.displacement.value_mm.data()[i] +=
        0.02F * Eigen::Vector3f(normal(random), 0, normal(random)) + 0.06F * normal(random) * axis;
    measured.frame.displacement.sigma_random_mm.data()[i].setConstant(0.02F);
  }
  const Eigen::Vector3d within = measured.Compare().within_two_sigma_displacement;
  EXPECT_NEAR(within.x(), 0.954, 0.015);
  EXPECT_NEAR(within.y(), 0.954, 0.015);
  EXPECT_NEAR(within.z(), 0.495, 0.03);
}

// Twenty wrong points in thousands: the root mean square tells of them, the rest is as before.
TEST(TruthComparison, FewWrongPointsDoNotTurnAllOthers) {
  Measured measured(0.01, 0.01);
  int wrong = 0;
  for (std::size_t i = 0; i < measured.frame.surface.status.pixel_count() && wrong < 20; ++i) {
    if (measured.frame.surface.status.data()[i] != Status::kOk) continue;
    measured.frame.surface.position_mm.data()[i].z() += 60;
    ++wrong;
  }
  ASSERT_EQ(wrong, 20);
  const TruthComparison comparison = measured.Compare();
  EXPECT_GT(comparison.rms_height_mm, 2);
  EXPECT_NEAR(comparison.median_height_error_mm, 0.6745 * 0.01, 0.001);
  EXPECT_NEAR(comparison.within_one_sigma, 0.683, 0.03);
}

TEST(TruthComparison, CountsPointsWithoutASurface) {
  Scenario scenario = MakeScenario("still", RigKind::kWide640);  // smaller than the view
  const VirtualRig rig(scenario);
  const TruthSeries truth(rig);
  SeriesFrame frame = truth.Frame(0);
  const Image<Eigen::Vector2f> grid_px = truth.Header().grid_px;
  ASSERT_EQ(frame.surface.status(0, 0), Status::kMasked);
  frame.surface.status(0, 0) = Status::kOk;
  frame.surface.position_mm(0, 0).setZero();
  EXPECT_EQ(CompareWithTruth(frame, grid_px, *rig.Truth(0)).unfounded, 1);
}

}  // namespace
}  // namespace plumbline
