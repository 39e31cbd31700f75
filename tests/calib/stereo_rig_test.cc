#include "calib/stereo_rig.h"

#include <gtest/gtest.h>

namespace plumbline {
namespace {

StereoRig MakeRig() {
  Eigen::VectorXd p(9);
  p << 1000, 1001, 320, 240, 0.01, -0.02, 1e-4, 2e-4, 0.003;
  const Camera camera(LensModel::FromName("opencv5"), {640, 480}, p);
  return {camera, camera, Rigid3::FromRotationVector({0.01, -0.3, 0.02}, {100, 1, 15}), {}, ""};
}

TEST(StereoRig, ParametersGoThereAndBack) {
  const StereoRig rig = MakeRig();
  Eigen::VectorXd p = rig.Parameters();
  ASSERT_EQ(p.size(), 24);
  p[0] += 3;
  p[20] += 0.01;
  EXPECT_LT((rig.WithParameters(p).Parameters() - p).norm(), 1e-12);
  EXPECT_THROW((void)rig.WithParameters(p.head(23)), std::invalid_argument);
}

TEST(CalibrationCovariance, OfAParameterIsItsModesSquared) {
  StereoRig rig = MakeRig();
  rig.modes.modes = Eigen::MatrixXd::Zero(2, 24);
  rig.modes.modes(0, 21) = 0.03;
  rig.modes.modes(1, 21) = 0.04;
  rig.modes.modes(1, 0) = 2;
  const auto covariance = CalibrationCovariance(rig, [](const StereoRig& r) -> Eigen::VectorXd {
    return Eigen::Vector2d(r.right_from_left.translation_mm.x(), r.left.parameters()[0]);
  });
  EXPECT_NEAR(covariance(0, 0), 0.0025, 1e-12);
  EXPECT_NEAR(covariance(1, 1), 4, 1e-9);
  EXPECT_NEAR(covariance(0, 1), 0.08, 1e-10);
}

}  // namespace
}  // namespace plumbline
