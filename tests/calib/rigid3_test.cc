#include "calib/rigid3.h"

#include <gtest/gtest.h>

#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

TEST(Rigid3, InverseUndoes) {
  const Rigid3 a = Rigid3::FromRotationVector({0.3, -1.2, 0.7}, {10, -20, 30});
  const Eigen::Vector3d p(1, 2, 3);
  EXPECT_LT((a.Inverse() * (a * p) - p).norm(), 1e-13);
  EXPECT_LT(((a * a.Inverse()).Matrix() - Eigen::Matrix4d::Identity()).norm(), 1e-13);
}

TEST(Rigid3, RotationVectorGoesThereAndBack) {
  const Eigen::Vector3d r(0.3, -1.2, 0.7);
  EXPECT_LT((Rigid3::FromRotationVector(r, {0, 0, 0}).RotationVector() - r).norm(), 1e-13);
  EXPECT_EQ(Rigid3{}.RotationVector(), Eigen::Vector3d::Zero());
}

TEST(RotationFromVector, DerivativesMatchFiniteDifferencesAlsoAtZero) {
  for (const Eigen::Vector3d& r :
       {Eigen::Vector3d(0.3, -1.2, 0.7), Eigen::Vector3d(0, 0, 0),
        Eigen::Vector3d(1e-9, 2e-9, -1e-9), Eigen::Vector3d(3.0, 0.1, 0.2),
        Eigen::Vector3d(1e-5, 1e-5, 0)}) {
    Eigen::Matrix3d dR[3];
    RotationFromVector(r, dR);
    const auto numeric = testing::NumericJacobian(
        [](const Eigen::VectorXd& v) -> Eigen::VectorXd {
          return RotationFromVector(Eigen::Vector3d(v)).reshaped();
        },
        r);
    for (int k = 0; k < 3; ++k)
      EXPECT_LT((dR[k].reshaped() - numeric.col(k)).norm(), 1e-9) << r.transpose();
  }
}

}  // namespace
}  // namespace plumbline
