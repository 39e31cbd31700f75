#include "track/strain_measure.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>

#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

constexpr std::array<StrainMeasure, 4> kAll = {StrainMeasure::kGreenLagrange, StrainMeasure::kSmall,
                                               StrainMeasure::kHencky, StrainMeasure::kAlmansi};

Eigen::Matrix2d Rotation(double angle_rad) {
  Eigen::Matrix2d R;
  R << std::cos(angle_rad), -std::sin(angle_rad), std::sin(angle_rad), std::cos(angle_rad);
  return R;
}

Eigen::Matrix2d GradientOf(const Eigen::Matrix2d& F) { return F - Eigen::Matrix2d::Identity(); }

void ExpectStrain(const Eigen::Vector3d& actual, const Eigen::Vector3d& expected) {
  EXPECT_LT((actual - expected).cwiseAbs().maxCoeff(), 1e-12)
      << actual.transpose() << " for " << expected.transpose();
}

TEST(StrainMeasure, OfStretchIsTheClosedForm) {
  const double a = 1.2, b = 0.9;
  const Eigen::Matrix2d G = GradientOf(Eigen::Vector2d(a, b).asDiagonal());
  ExpectStrain(StrainOf(G, StrainMeasure::kGreenLagrange).strain,
               {(a * a - 1) / 2, (b * b - 1) / 2, 0});
  ExpectStrain(StrainOf(G, StrainMeasure::kSmall).strain, {a - 1, b - 1, 0});
  ExpectStrain(StrainOf(G, StrainMeasure::kHencky).strain, {std::log(a), std::log(b), 0});
  ExpectStrain(StrainOf(G, StrainMeasure::kAlmansi).strain,
               {(1 - 1 / (a * a)) / 2, (1 - 1 / (b * b)) / 2, 0});
}

TEST(StrainMeasure, OfSimpleShearIsTheClosedForm) {
  const double k = 0.3;  // u = k y
  Eigen::Matrix2d G;
  G << 0, k, 0, 0;
  ExpectStrain(StrainOf(G, StrainMeasure::kGreenLagrange).strain, {0, k * k / 2, k / 2});
  ExpectStrain(StrainOf(G, StrainMeasure::kSmall).strain, {0, 0, k / 2});
  ExpectStrain(StrainOf(G, StrainMeasure::kAlmansi).strain, {0, -k * k / 2, k / 2});
  // Its principal stretches are l and 1/l with l - 1/l = k; in the reference the longer one stands
  // at the angle t with tan(2 t) = -2 / k.
  const GradientStrain hencky = StrainOf(G, StrainMeasure::kHencky);
  const StrainInvariants invariants = InvariantsOf(hencky.strain);
  EXPECT_NEAR(invariants.principal[0], std::asinh(k / 2), 1e-12);
  EXPECT_NEAR(invariants.principal[1], -std::asinh(k / 2), 1e-12);
  EXPECT_NEAR(invariants.angle_rad, 0.5 * std::atan2(2, -k), 1e-12);
  EXPECT_NEAR(hencky.rotation_rad, -std::atan(k / 2), 1e-12);
}

TEST(StrainMeasure, OfRotationIsNone) {
  for (const double degrees : {30.0, -120.0, 179.0}) {
    const double angle = degrees * M_PI / 180;
    for (const StrainMeasure measure : kAll) {
      const GradientStrain result = StrainOf(GradientOf(Rotation(angle)), measure);
      EXPECT_NEAR(result.rotation_rad, angle, 1e-12);
      if (measure == StrainMeasure::kSmall) continue;
      ExpectStrain(result.strain, Eigen::Vector3d::Zero());
    }
  }
}

TEST(StrainMeasure, StaysOrTurnsWithTheMaterial) {
  const Eigen::Matrix2d U = Rotation(0.4) * Eigen::Vector2d(1.3, 0.8).asDiagonal() * Rotation(-0.4);
  const Eigen::Matrix2d R = Rotation(0.9);
  for (const StrainMeasure measure : {StrainMeasure::kGreenLagrange, StrainMeasure::kHencky}) {
    ExpectStrain(StrainOf(GradientOf(R * U), measure).strain,
                 StrainOf(GradientOf(U), measure).strain);
  }
  const auto tensor = [](const Eigen::Vector3d& e) {
    return (Eigen::Matrix2d() << e[0], e[2], e[2], e[1]).finished();
  };
  const auto still = tensor(StrainOf(GradientOf(U), StrainMeasure::kAlmansi).strain);
  const auto turned = tensor(StrainOf(GradientOf(R * U), StrainMeasure::kAlmansi).strain);
  EXPECT_LT((turned - R * still * R.transpose()).norm(), 1e-12);
  EXPECT_NEAR(StrainOf(GradientOf(R * U), StrainMeasure::kSmall).rotation_rad, 0.9, 1e-12);
}

TEST(StrainMeasure, DerivativesAreThoseOfTheValues) {
  const std::vector<Eigen::Vector4d> gradients = {
      {0, 0, 0, 0}, {0.1, 0, 0, 0.1}, {0.2, -0.1, 0.05, -0.15}, {-0.3, 0.8, -0.6, 0.1}};
  for (const StrainMeasure measure : kAll) {
    for (const Eigen::Vector4d& g : gradients) {
      const auto at = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        Eigen::Matrix2d G;
        G << x[0], x[1], x[2], x[3];
        const GradientStrain result = StrainOf(G, measure);
        return (Eigen::Vector4d() << result.strain, result.rotation_rad).finished();
      };
      Eigen::Matrix2d G;
      G << g[0], g[1], g[2], g[3];
      const GradientStrain result = StrainOf(G, measure);
      Eigen::Matrix4d J;
      J << result.d_strain, result.d_rotation;
      EXPECT_LT((J - testing::NumericJacobian(at, g)).cwiseAbs().maxCoeff(), 1e-8)
          << Name(measure) << ' ' << g.transpose();
    }
  }
}

TEST(StrainMeasure, KeepsTheDigitsOfTinyStrains) {
  Eigen::Matrix2d G;
  G << 1e-9, 2e-10, 3e-10, -1e-9;
  for (const StrainMeasure measure : kAll) {
    const Eigen::Vector3d strain = StrainOf(G, measure).strain;
    EXPECT_LT((strain - Eigen::Vector3d(1e-9, -1e-9, 2.5e-10)).norm(), 1e-15) << Name(measure);
  }
}

TEST(StrainMeasure, IsNotANumberWhereTheMaterialFolds) {
  for (const StrainMeasure measure : kAll) {
    EXPECT_TRUE(StrainOf(GradientOf(Eigen::Vector2d(1, -0.1).asDiagonal()), measure)
                    .strain.array()
                    .isNaN()
                    .all());
    EXPECT_TRUE(std::isnan(StrainOf(Eigen::Matrix2d::Constant(NAN), measure).rotation_rad));
  }
}

TEST(StrainInvariants, AreThoseOfMohrsCircle) {
  const StrainInvariants shear = InvariantsOf({0, 0, 0.01});
  EXPECT_NEAR(shear.principal[0], 0.01, 1e-15);
  EXPECT_NEAR(shear.principal[1], -0.01, 1e-15);
  EXPECT_NEAR(shear.angle_rad, M_PI / 4, 1e-15);
  EXPECT_NEAR(shear.max_shear, 0.01, 1e-15);
  EXPECT_NEAR(InvariantsOf({0, 0.02, 0}).angle_rad, M_PI / 2, 1e-15);
  // Simple tension of what keeps its volume: the strain along the load.
  EXPECT_NEAR(InvariantsOf({0.02, -0.01, 0}).von_mises, 0.02, 1e-15);
  const StrainInvariants equal = InvariantsOf({0.01, 0.01, 0});
  EXPECT_TRUE(std::isnan(equal.angle_rad));
  EXPECT_TRUE(equal.d_angle.array().isNaN().all());
  EXPECT_NEAR(equal.principal[1], 0.01, 1e-15);
  EXPECT_EQ(InvariantsOf({0, 0, 0}).von_mises, 0);
}

TEST(StrainInvariants, DerivativesAreThoseOfTheValues) {
  for (const Eigen::Vector3d& e : {Eigen::Vector3d(0.3, 0.1, 0.05), Eigen::Vector3d(-0.2, 0.4, 0.3),
                                   Eigen::Vector3d(0.1, -0.3, -0.2)}) {
    const auto at = [](const Eigen::VectorXd& x) -> Eigen::VectorXd {
      const StrainInvariants v = InvariantsOf(x);
      Eigen::VectorXd all(5);
      all << v.principal, v.angle_rad, v.max_shear, v.von_mises;
      return all;
    };
    const StrainInvariants v = InvariantsOf(e);
    Eigen::Matrix<double, 5, 3> J;
    J << v.d_principal, v.d_angle, v.d_max_shear, v.d_von_mises;
    EXPECT_LT((J - testing::NumericJacobian(at, e)).cwiseAbs().maxCoeff(), 1e-8) << e.transpose();
  }
}

TEST(StrainInvariants, HaveNoSigmaWhereTheyHaveNoDerivative) {
  const Eigen::Matrix3d cov = Eigen::Vector3d(4e-8, 1e-8, 2e-8).asDiagonal();
  // Along the axes: the principals are xx and yy, and only xy turns them.
  const InvariantSigmas apart = SigmasOf(InvariantsOf({0.03, 0.01, 0}), cov);
  EXPECT_NEAR(apart.principal[0], 2e-4, 1e-12);
  EXPECT_NEAR(apart.principal[1], 1e-4, 1e-12);
  EXPECT_NEAR(apart.angle_rad, std::sqrt(2e-8) / 0.02, 1e-10);
  EXPECT_NEAR(apart.max_shear, 0.5 * std::sqrt(5e-8), 1e-12);
  const InvariantSigmas equal = SigmasOf(InvariantsOf({0.02, 0.02, 0}), cov);
  EXPECT_TRUE(equal.principal.array().isNaN().all());
  EXPECT_TRUE(std::isnan(equal.angle_rad));
  EXPECT_TRUE(std::isnan(equal.max_shear));
  EXPECT_GT(equal.von_mises, 0);
}

}  // namespace
}  // namespace plumbline
