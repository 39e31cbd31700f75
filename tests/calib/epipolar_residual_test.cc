#include "calib/internal/epipolar_residual.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "calib/triangulate.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

TEST(EpipolarResidual, IsThatOfTriangulateWithExactDerivatives) {
  Eigen::VectorXd p(8), q(9);
  p << 2500, 2503, 640, 512, -0.12, 0.15, 1e-3, -7e-4;
  q << 2512, 2510, 655, 498, -0.15, 0.12, -6e-4, 8e-4, -0.03;
  const StereoRig rig{Camera(LensModel::FromName("opencv4"), {1280, 1024}, p),
                      Camera(LensModel::FromName("opencv5"), {1280, 1024}, q),
                      Rigid3::FromRotationVector({0.01, 0.35, -0.015}, {-171, 2, 31}),
                      {},
                      ""};
  const Eigen::Vector3d point(20, -35, 480);
  StereoObservation seen;
  seen.left = rig.left.Project(point);
  seen.right = rig.right.Project(rig.right_from_left * point) + Eigen::Vector2d(1, 2);
  Eigen::Matrix4d L;
  L << 0.10, 0, 0, 0, 0.02, 0.12, 0, 0, 0.05, 0.01, 0.09, 0, -0.01, 0.03, 0.02, 0.11;
  seen.cov_px2 = L * L.transpose();
  const auto left = rig.left.UnprojectWithJacobians(seen.left);
  const auto right = rig.right.UnprojectWithJacobians(seen.right);
  const internal::MatchRays match{left.ray, right.ray, left.d_ray_d_pixel, right.d_ray_d_pixel,
                                  seen.cov_px2};
  const Eigen::Matrix3d& R = rig.right_from_left.rotation;
  const Eigen::Vector3d t = rig.right_from_left.translation_mm.normalized();
  Eigen::Matrix<double, 3, 2> B;
  B << t.unitOrthogonal(), t.cross(t.unitOrthogonal());
  const auto at = [&](const Eigen::VectorXd& d) {
    const Rigid3 moved = Rigid3::FromRotationVector(d.head<3>(), B * d.tail<2>()) * Rigid3{R, t};
    return internal::EvaluateEpipolar(match, moved.rotation, moved.translation_mm, B);
  };
  const internal::EpipolarResidual r = at(Eigen::VectorXd::Zero(5));
  const Eigen::MatrixXd numeric = testing::NumericJacobian(
      [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
        return Eigen::VectorXd::Constant(1, at(d).z);
      },
      Eigen::VectorXd::Zero(5), 1e-5);
  EXPECT_GT(std::abs(r.z), 5);
  EXPECT_LT((r.d_z - numeric).norm(), 1e-7 * numeric.norm());
  EXPECT_GT((r.d_a - numeric).norm(), 1e-6 * numeric.norm());
  const Eigen::MatrixXd constraint = testing::NumericJacobian(
      [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
        return Eigen::VectorXd::Constant(1, at(d).z * at(d).sigma / r.sigma);
      },
      Eigen::VectorXd::Zero(5), 1e-5);
  EXPECT_LT((r.d_a - constraint).norm(), 1e-7 * constraint.norm());
  const TriangulatedPoint expected = Triangulate(rig, seen);
  EXPECT_NEAR(r.distance_px, expected.epipolar_px, 1e-9);
  EXPECT_NEAR(r.z, expected.epipolar_px / expected.sigma_epipolar_px, 1e-9 * std::abs(r.z));
}

}  // namespace
}  // namespace plumbline
