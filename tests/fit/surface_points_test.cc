#include "fit/surface_points.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>

namespace plumbline {
namespace {

const ImageSize kSize{6, 5};

SurfacePoints Points() {
  SurfacePoints points;
  points.point_mm = Image<Eigen::Vector3d>(kSize, Eigen::Vector3d::Zero());
  Eigen::Matrix<float, 6, 1> cov;
  cov << 4e-4F, 1e-4F, -2e-4F, 5e-4F, 3e-4F, 64e-4F;
  points.cov_random_mm2 = Image<Eigen::Matrix<float, 6, 1>>(kSize, cov);
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 100);
  for (Eigen::Vector3d& p : points.point_mm.values()) {
    for (double& x : p) x = normal(random);
  }
  return points;
}

Eigen::Matrix<double, 6, 6> FrameCovariance() {
  Eigen::Matrix<double, 6, 6> root = Eigen::Matrix<double, 6, 6>::Zero();
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k <= i; ++k) root(i, k) = (i < 3 ? 1e-4 : 0.02) * (i == k ? 1 : 0.3);
  }
  return root * root.transpose();
}

TEST(SurfacePoints, CarryTheFramesErrors) {
  SurfacePoints points = Points();
  points.along_modes_mm.emplace_back(kSize, Eigen::Vector3f(0.1F, 0, 0));
  UncertainFrame frame;
  frame.frame_from_rig = Rigid3::FromRotationVector({0.4, -2, 0.3}, {10, -20, 300});
  frame.cov_random = FrameCovariance();
  frame.along_modes = {Rigid3::FromRotationVector({1e-4, 0, 2e-4}, {0, 0, 0.1}) *
                       frame.frame_from_rig};
  const SurfacePoints told = InFrame(points, frame);
  ASSERT_EQ(told.along_common_mm.size(), 6U);
  for (std::size_t i = 0; i < points.point_mm.pixel_count(); ++i) {
    const Eigen::Vector3d q = frame.frame_from_rig * points.point_mm.data()[i];
    EXPECT_LT((told.point_mm.data()[i] - q).norm(), 1e-12);
    Eigen::Matrix<double, 3, 6> J;
    J << -Skew(q), Eigen::Matrix3d::Identity();
    Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();
    for (const auto& along : told.along_common_mm) {
      cov += (along.data()[i] * along.data()[i].transpose()).cast<double>();
    }
    EXPECT_LT((cov - J * frame.cov_random * J.transpose()).norm(), 1e-5 * cov.norm());
    const Eigen::Vector3d moved =
        frame.along_modes[0] * (points.point_mm.data()[i] + Eigen::Vector3d(0.1, 0, 0));
    EXPECT_LT((told.along_modes_mm[0].data()[i].cast<double>() - (moved - q)).norm(), 1e-5);
  }
  frame.along_modes.push_back(frame.frame_from_rig);
  EXPECT_THROW((void)InFrame(points, frame), std::invalid_argument);
  points.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>({2, 2}, Eigen::Matrix<float, 6, 1>::Zero());
  EXPECT_THROW(points.Check(), std::invalid_argument);
}

TEST(SurfacePoints, NoiseOfASumIsThatOfSampling) {
  SurfacePoints points = Points();
  const NeighbourCorrelation overlapping = NeighbourCorrelation::OfOverlap(kSize, 5, 15, 1);
  // Some points of the grid, in rows apart and together.
  std::vector<PointChange> changes;
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  for (std::size_t place = 0; place < points.point_mm.pixel_count(); ++place) {
    if (place % 3 == 1) continue;
    PointChange::Matrix change(2, 3);
    for (double& x : change.reshaped()) x = normal(random);
    changes.push_back({place, change});
  }
  // One that has no depth error at all.
  points.cov_random_mm2.data()[5] << 1e-4F, 0, 0, 1e-4F, 0, 0;
  const Eigen::MatrixXd claimed = IndependentCovariance(changes, points, overlapping);
  Eigen::Matrix3d root, flat = Eigen::Matrix3d::Zero();
  root << 4e-4, 1e-4, -2e-4, 1e-4, 5e-4, 3e-4, -2e-4, 3e-4, 64e-4;
  root = Eigen::Matrix3d(root.llt().matrixL());
  flat.diagonal() << 0.01, 0.01, 0;
  Eigen::Matrix2d sampled = Eigen::Matrix2d::Zero();
  constexpr int kDraws = 20000;
  for (int draw = 0; draw < kDraws; ++draw) {
    Image<Eigen::Vector3d> white({kSize.width + 2, kSize.height + 2}, Eigen::Vector3d::Zero());
    for (Eigen::Vector3d& w : white.values()) {
      for (double& x : w) x = normal(random);
    }
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const PointChange& c : changes) {
      const int row = static_cast<int>(c.place) / kSize.width;
      const int column = static_cast<int>(c.place) % kSize.width;
      Eigen::Vector3d e = Eigen::Vector3d::Zero();
      for (int k = 0; k < 9; ++k) e += white(row + k / 3, column + k % 3) / 3;
      sum += c.change * ((c.place == 5 ? flat : root) * e);
    }
    sampled += sum * sum.transpose() / kDraws;
  }
  EXPECT_NEAR(claimed(0, 0) / sampled(0, 0), 1, 0.04);
  EXPECT_NEAR(claimed(1, 1) / sampled(1, 1), 1, 0.04);
  EXPECT_NEAR(claimed(0, 1), sampled(0, 1), 0.03 * std::sqrt(sampled(0, 0) * sampled(1, 1)));
}

TEST(ErrorSum, AddsWhatIsInCommonBeforeItIsSquared) {
  ErrorSum errors(1, 2);
  errors.AddIndependent(9);
  errors.AddCommon(Eigen::RowVectorXd::Constant(1, 5));
  errors.AddCommon(Eigen::RowVectorXd::Constant(1, -1));
  errors.AddModes(Eigen::RowVector2d(1, 2));
  errors.AddScalar(2, {0, 0, Eigen::Vector2d(-0.5, 1)});
  const MeasuredScalar sum = errors.Of(7);
  EXPECT_EQ(sum.value, 7);
  EXPECT_EQ(sum.sigma_random, 5);
  EXPECT_EQ(sum.sigma_calibration(), 4);
  errors.AddScalar(1, {0, 0, Eigen::Vector3d(0, 0, 3)});  // of another rig
  EXPECT_EQ(errors.Of(7).sigma_calibration(), 5);
  EXPECT_TRUE(std::isnan(ErrorSum(0, 0).Of(1).sigma_calibration()));
}

}  // namespace
}  // namespace plumbline
