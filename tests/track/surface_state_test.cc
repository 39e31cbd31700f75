#include "track/surface_state.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <vector>

namespace plumbline {
namespace {

// One point that was matched in both images, with noise of its own shape in each.
StereoField OnePoint(const Eigen::Vector3f& left_px2, const Eigen::Vector3f& right_px2) {
  StereoField field;
  field.left = PlanarField({1, 1}, {100, 100}, 10);
  for (PlanarField* side : {&field.left, &field.right}) {
    *side = PlanarField({1, 1}, {100, 100}, 10);
    side->status(0, 0) = Status::kOk;
    side->displacement_px(0, 0).setZero();
    side->gradient = Image<Eigen::Matrix2f>({1, 1}, Eigen::Matrix2f::Zero());
    side->reference_share = Image<float>({1, 1}, 0.9F);
  }
  field.left.cov_displacement_px2 = Image<Eigen::Vector3f>({1, 1}, left_px2);
  field.right.cov_displacement_px2 = Image<Eigen::Vector3f>({1, 1}, right_px2);
  return field;
}

double LeastVariance(const StereoObservation& observation) {
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(observation.cov_px2).eigenvalues()[0];
}

TEST(ObservationsOf, HaveNoiseInEveryDirectionWhereBothImagesShareMostOfIt) {
  // Both are sure across each other: of the shape of the reference, what they share would be more
  // than either has.
  const StereoField field = OnePoint({1e-4F, 0, 1e-6F}, {1e-6F, 0, 1e-4F});
  const Image<Eigen::Vector3f> unit({1, 1}, {1e-4F, 0, 1e-4F});
  const std::vector<StereoObservation> observations = ObservationsOf(field, unit);
  ASSERT_EQ(observations.size(), 1U);
  EXPECT_GT(LeastVariance(observations[0]), 0.01 * 1e-6);
  // What is alike stays as it is told.
  const StereoField alike = OnePoint({1e-4F, 0, 1e-4F}, {1e-4F, 0, 1e-4F});
  const StereoObservation told = ObservationsOf(alike, unit).at(0);
  EXPECT_NEAR(told.cov_px2(0, 2), 0.9e-4, 1e-9);
}

TEST(ObservationsOf, AreThoseOfAReferencePairWhoseLeftImageIsItsOwn) {
  const StereoField field = OnePoint({0, 0, 0}, {1e-4F, 0, 1e-4F});
  const std::vector<StereoObservation> observations =
      ObservationsOf(field, UnitCovariance(field, field));
  ASSERT_EQ(observations.size(), 1U);
  EXPECT_TRUE((observations[0].cov_px2.topLeftCorner<2, 4>().isZero()));
  EXPECT_NEAR(observations[0].cov_px2(3, 3), 1e-4, 1e-9);
  const StereoField none = OnePoint({0, 0, 0}, {1e-4F, 0, 0});
  EXPECT_TRUE(ObservationsOf(none, UnitCovariance(none, none)).empty());
}

}  // namespace
}  // namespace plumbline
