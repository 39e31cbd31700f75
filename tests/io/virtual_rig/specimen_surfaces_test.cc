#include "io/virtual_rig/specimen_surfaces.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "tests/io/virtual_rig/surface_checks.h"

namespace plumbline {
namespace {

using Shape = SpecimenOptions::Shape;

SpecimenOptions Everything(Shape shape) {
  SpecimenOptions options;
  options.shape = shape;
  options.displacement_gradient << 0.02, 0.01, -0.003, -0.006;
  options.star_amplitude_mm = 0.05;
  options.star_period_min_mm = 4;
  options.rotation_rad = {0.1, -0.05, 0.2};
  options.translation_mm = {1, 2, -3};
  return options;
}

TEST(Specimen, TangentsAndVelocityAreDerivativesOfPosition) {
  for (const Shape shape : {Shape::kPlane, Shape::kIncline, Shape::kCylinder}) {
    const auto specimen = MakeSpecimen(Everything(shape));
    for (double u = -58; u < 60; u += 8.3) {
      for (double v = -40; v < 45; v += 9.7) {
        EXPECT_LT(testing::LargestDerivativeError(*specimen, {u, v}, 0.6), 1e-6) << u << " " << v;
      }
    }
  }
}

TEST(Specimen, StrainOfPositionsConvergesToTheStatedStrainAtSecondOrder) {
  for (const Shape shape : {Shape::kPlane, Shape::kIncline, Shape::kCylinder}) {
    const auto specimen = MakeSpecimen(Everything(shape));
    const auto now = specimen->At(1), reference = specimen->Reference(1);
    double coarse = 0, fine = 0;
    for (double u = -50; u < 55; u += 7.1) {
      const Eigen::Vector2d m(u, 0.6 * u);
      const Eigen::Vector3d exact = GreenLagrangeStrain(reference->At(m), now->At(m));
      coarse += (testing::StrainByDifferences(*reference, *now, m, 0.1) - exact).squaredNorm();
      fine += (testing::StrainByDifferences(*reference, *now, m, 0.05) - exact).squaredNorm();
    }
    EXPECT_NEAR(std::sqrt(coarse / fine), 4, 0.1);
  }
}

TEST(Specimen, StretchHasTheGreenLagrangeStrainOfItsGradient) {
  SpecimenOptions options;
  options.displacement_gradient << 0.02, 0.01, 0, -0.006;
  options.rotation_rad = {0.3, -0.2, 0.4};  // leaves no trace in it
  const auto specimen = MakeSpecimen(options);
  const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + options.displacement_gradient;
  const Eigen::Matrix2d E = 0.5 * (F.transpose() * F - Eigen::Matrix2d::Identity());
  const Eigen::Vector3d strain =
      GreenLagrangeStrain(specimen->Reference(1)->At({5, 7}), specimen->At(1)->At({5, 7}));
  EXPECT_LT((strain - Eigen::Vector3d(E(0, 0), E(1, 1), E(0, 1))).norm(), 1e-14);
}

TEST(Specimen, RigidMotionMakesNoStrain) {
  SpecimenOptions options;
  options.shape = Shape::kCylinder;
  options.rotation_rad = {0.1, 0.2, -0.1};
  options.translation_mm = {5, -20, 3};
  const auto specimen = MakeSpecimen(options);
  EXPECT_LT(
      GreenLagrangeStrain(specimen->Reference(1)->At({9, 7}), specimen->At(1)->At({9, 7})).norm(),
      1e-14);
}

TEST(Specimen, InclineRisesWithItsAngleBesideTheCrease) {
  SpecimenOptions options;
  options.shape = Shape::kIncline;
  const auto now = MakeSpecimen(options)->At(0);
  EXPECT_EQ(now->At({-10, 3}).position_mm.z(), 0);
  EXPECT_NEAR(now->At({30, 3}).position_mm.z(), 30 * std::tan(options.incline_rad), 1e-12);
}

TEST(Specimen, CylinderKeepsArcLength) {
  SpecimenOptions options;
  options.shape = Shape::kCylinder;
  const auto now = MakeSpecimen(options)->At(0);
  const SurfacePoint p = now->At({40, 3});
  EXPECT_NEAR(p.d_position_d_material.col(0).norm(), 1, 1e-12);
  EXPECT_NEAR(std::hypot(p.position_mm.x(), p.position_mm.z() + 60), 60, 1e-12);
}

TEST(Specimen, RefusesWhatItCannotBe) {
  SpecimenOptions options;
  options.shape = Shape::kCylinder;
  options.cylinder_radius_mm = 20;
  EXPECT_THROW(MakeSpecimen(options), UsageError);
  options = {};
  options.end_time_s = 0;
  EXPECT_THROW(MakeSpecimen(options), UsageError);
}

}  // namespace
}  // namespace plumbline
