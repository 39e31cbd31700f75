#include "track/internal/tangent_deformation.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <vector>

#include "tests/support/numeric_jacobian.h"

namespace plumbline::internal {
namespace {

using Rows = Eigen::Matrix<double, 3, 2, Eigen::RowMajor>;

struct Pair {
  Tangents reference, now;
};

// Tilted to the camera and to each other by tens of degrees.
std::vector<Pair> Pairs() {
  std::vector<Pair> pairs;
  for (int i = 0; i < 6; ++i) {
    Pair pair;
    pair.reference << 0.5, 0.04 * i, 0.03, 0.45, 0.2 - 0.1 * i, 0.15;
    pair.now << 0.55, -0.1 + 0.05 * i, 0.08, 0.5, -0.3, 0.1 * i - 0.2;
    pairs.push_back(pair);
  }
  return pairs;
}

std::vector<std::optional<Eigen::Vector3d>> Directions() {
  return {std::nullopt, Eigen::Vector3d(0.3, -2, 0.8)};
}

TEST(TangentDeformation, TurnsTheAxesByTheSmallestRotation) {
  for (const Pair& pair : Pairs()) {
    for (const auto& direction : Directions()) {
      const TangentDeformation out = DeformationOf(pair.reference, pair.now, direction);
      const Eigen::Vector3d n = out.axes.col(2);
      EXPECT_LT((out.axes.transpose() * out.axes - Eigen::Matrix3d::Identity()).norm(), 1e-14);
      EXPECT_GT(out.axes.determinant(), 0);
      // Columns run to the right, rows downwards and z forward, away from the camera.
      EXPECT_LT(n.z(), 0);
      const Eigen::Vector3d along = direction.value_or(pair.reference.col(0));
      EXPECT_GT(out.axes.col(0).dot(along), 0);
      EXPECT_NEAR(out.axes.col(1).dot(along), 0, 1e-14);
      const Eigen::Vector3d n_now = pair.now.col(1).cross(pair.now.col(0)).normalized();
      const Eigen::Matrix3d Q = Eigen::Quaterniond::FromTwoVectors(n, n_now).toRotationMatrix();
      const Tangents e = out.axes.leftCols<2>();
      const Eigen::Matrix2d expected =
          (Q * e).transpose() * pair.now * (e.transpose() * pair.reference).inverse();
      EXPECT_LT((out.F - expected).norm(), 1e-13);
      EXPECT_GT(out.F.determinant(), 0);
    }
  }
}

TEST(TangentDeformation, DerivativesAreThoseOfFiniteDifferences) {
  for (const Pair& pair : Pairs()) {
    for (const auto& direction : Directions()) {
      const auto deformation = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        const Tangents reference = Eigen::Map<const Rows>(x.data());
        const Tangents now = Eigen::Map<const Rows>(x.data() + 6);
        const Eigen::Matrix2d F = DeformationOf(reference, now, direction).F;
        return Eigen::Vector4d(F(0, 0), F(0, 1), F(1, 0), F(1, 1));
      };
      Eigen::VectorXd x(12);
      Eigen::Map<Rows>(x.data()) = pair.reference;
      Eigen::Map<Rows>(x.data() + 6) = pair.now;
      const Eigen::MatrixXd numeric = testing::NumericJacobian(deformation, x, 1e-3);
      const TangentDeformation out = DeformationOf(pair.reference, pair.now, direction);
      EXPECT_LT((out.d_reference - numeric.leftCols<6>()).norm(), 1e-8 * numeric.norm());
      EXPECT_LT((out.d_now - numeric.rightCols<6>()).norm(), 1e-8 * numeric.norm());
    }
  }
}

TEST(TangentDeformation, IsNoneWithoutATangentPlaneOrAnXAxis) {
  const Pair pair = Pairs()[0];
  Tangents line = pair.now;
  line.col(1) = 2 * line.col(0);
  EXPECT_FALSE(DeformationOf(pair.reference, line, std::nullopt).F.allFinite());
  EXPECT_FALSE(DeformationOf(line, pair.now, std::nullopt).F.allFinite());
  const Eigen::Vector3d normal = pair.reference.col(0).cross(pair.reference.col(1));
  EXPECT_FALSE(DeformationOf(pair.reference, pair.now, normal).F.allFinite());
}

}  // namespace
}  // namespace plumbline::internal
