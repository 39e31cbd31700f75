#include "match/subset_warp.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <stdexcept>

#include "tests/support/numeric_jacobian.h"
#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

// Turned by 0.5 rad, stretched and moved.
SubsetWarp Affine() {
  Eigen::Matrix2d gradient = Eigen::Rotation2Dd(0.5).toRotationMatrix();
  gradient.col(0) *= 1.2;
  return SubsetWarp::Of({3.4, -2.1}, gradient - Eigen::Matrix2d::Identity());
}

// An affine warp with a second order of this size.
SubsetWarp Quadratic(std::uint32_t seed, double second_order) {
  testing::NormalDeviates draw(seed);
  SubsetWarp warp;
  for (int i = 0; i < 2; ++i) {
    for (int k = 0; k < 3; ++k) warp.c(i, k) = (k == 0 ? 1.0 : 0.2) * draw();
    for (int k = 3; k < 6; ++k) warp.c(i, k) = second_order * draw();
  }
  return warp;
}

const Eigen::Vector2d kOffsets[] = {{0, 0}, {1, 0}, {0, -1}, {12.5, 7.25}, {-16, 16}, {3, -15}};

void ExpectNear(const Eigen::Vector2d& a, const Eigen::Vector2d& b, double tolerance) {
  EXPECT_LT((a - b).norm(), tolerance) << a.transpose() << " and " << b.transpose();
}

TEST(SubsetWarp, AppliesItsFormula) {
  SubsetWarp warp;
  warp.c << 1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -6;
  // x = 2, y = 3: 1 + 4 + 9 + 16 + 30 + 54 = 114.
  EXPECT_EQ(warp.Apply({2, 3}), Eigen::Vector2d(2 + 114, 3 - 114));
  EXPECT_EQ(warp.displacement_px(), Eigen::Vector2d(1, -1));
  EXPECT_EQ(warp.gradient(), (Eigen::Matrix2d() << 2, 3, -2, -3).finished());
}

TEST(SubsetWarp, ComposesAffineWarpsExactly) {
  const SubsetWarp outer = Affine();
  const SubsetWarp inner =
      SubsetWarp::Of({-7, 4}, (Eigen::Matrix2d() << 0.1, -0.3, 0.2, 0.05).finished());
  for (const Eigen::Vector2d& x : kOffsets) {
    ExpectNear(Compose(outer, inner).Apply(x), outer.Apply(inner.Apply(x)), 1e-12);
    ExpectNear(Compose(Inverse(outer), outer).Apply(x), x, 1e-12);
    ExpectNear(Compose(outer, Inverse(outer)).Apply(x), x, 1e-12);
  }
}

// Derivatives at 0 up to the second order of any map of the plane, as a warp has them.
SubsetWarp Expansion(const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& map) {
  const double h = 1e-3;
  const auto shift = [&](double x, double y) -> Eigen::Vector2d {
    return map(Eigen::Vector2d(x, y)) - Eigen::Vector2d(x, y);
  };
  SubsetWarp warp;
  warp.c.col(0) = shift(0, 0);
  warp.c.col(1) = (shift(h, 0) - shift(-h, 0)) / (2 * h);
  warp.c.col(2) = (shift(0, h) - shift(0, -h)) / (2 * h);
  warp.c.col(3) = (shift(h, 0) - 2 * shift(0, 0) + shift(-h, 0)) / (2 * h * h);
  warp.c.col(4) = (shift(h, h) - shift(h, -h) - shift(-h, h) + shift(-h, -h)) / (4 * h * h);
  warp.c.col(5) = (shift(0, h) - 2 * shift(0, 0) + shift(0, -h)) / (2 * h * h);
  return warp;
}

// What Compose means: outer(inner(x)) as a polynomial in x without its terms above the second
// order. Terms of higher order in finite differences of step 1e-3 stay far below the tolerance.
TEST(SubsetWarp, ComposesQuadraticWarpsUpToTheSecondOrder) {
  for (std::uint32_t seed = 1; seed < 6; ++seed) {
    const SubsetWarp outer = Quadratic(seed, 0.01), inner = Quadratic(seed + 100, 0.01);
    const SubsetWarp expected =
        Expansion([&](const Eigen::Vector2d& x) { return outer.Apply(inner.Apply(x)); });
    const SubsetWarp composed = Compose(outer, inner);
    EXPECT_LT((composed.c - expected.c).cwiseAbs().maxCoeff(), 1e-6) << composed.c - expected.c;
  }
}

TEST(SubsetWarp, CompositionLeavesARemainderOfTheThirdOrder) {
  const SubsetWarp outer = Quadratic(3, 0.01), inner = Quadratic(4, 0.01);
  const auto error = [&](double scale) {
    const Eigen::Vector2d x = scale * Eigen::Vector2d(0.6, -0.8);
    return (Compose(outer, inner).Apply(x) - outer.Apply(inner.Apply(x))).norm();
  };
  EXPECT_GT(error(2), 1e-6);
  EXPECT_NEAR(error(0.2) / error(0.1), 8, 0.5);
}

TEST(SubsetWarp, InverseUndoesAQuadraticWarpUpToTheSecondOrder) {
  for (std::uint32_t seed = 1; seed < 6; ++seed) {
    SubsetWarp warp = Quadratic(seed, 0.002);
    warp.c.col(0).setZero();  // so that 0 goes to 0, about which the remainder is small
    const SubsetWarp back = Inverse(warp);
    const SubsetWarp identity = Compose(warp, back);
    EXPECT_LT(identity.c.cwiseAbs().maxCoeff(), 1e-12) << identity.c;
    EXPECT_LT(Compose(back, warp).c.cwiseAbs().maxCoeff(), 1e-12);
    const auto error = [&](double scale) {
      const Eigen::Vector2d x = scale * Eigen::Vector2d(0.6, -0.8);
      return (back.Apply(warp.Apply(x)) - x).norm();
    };
    EXPECT_NEAR(error(0.4) / error(0.2), 8, 1) << seed;
  }
}

// A step of the correlator is a small warp: its inverse is good over a whole subset.
TEST(SubsetWarp, InverseOfASmallStepHoldsOverASubset) {
  SubsetWarp step = Quadratic(9, 0);
  step.c *= 0.05;
  step.c.rightCols<3>().setConstant(5e-5);
  for (const Eigen::Vector2d& x : kOffsets) ExpectNear(Inverse(step).Apply(step.Apply(x)), x, 2e-3);
}

TEST(SubsetWarp, InverseRefusesToFold) {
  EXPECT_THROW(Inverse(SubsetWarp::Of({0, 0}, (Eigen::Matrix2d() << -2, 0, 0, 0).finished())),
               std::domain_error);
  EXPECT_THROW(Inverse(SubsetWarp::Of({0, 0}, (Eigen::Matrix2d() << -1, 0, 0, 0).finished())),
               std::domain_error);
  SubsetWarp unknown;
  unknown.c(1, 4) = std::nan("");
  EXPECT_THROW(Inverse(unknown), std::domain_error);
}

TEST(SubsetWarp, TellsTheSameMotionFromAnotherCentre) {
  const SubsetWarp warp = Quadratic(5, 0.01);
  const Eigen::Vector2d by(-3, 8);
  const SubsetWarp moved = warp.MovedTo(by);
  for (const Eigen::Vector2d& x : kOffsets) {
    ExpectNear(by + moved.Apply(x), warp.Apply(by + x), 1e-12);
  }
  EXPECT_LT((moved.MovedTo(-by).c - warp.c).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(SubsetWarp, GradientIsTheDerivativeAtTheCentre) {
  const SubsetWarp warp = Quadratic(6, 0.01);
  const Eigen::MatrixXd J = testing::NumericJacobian(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd { return warp.Apply(x); },
      Eigen::VectorXd::Zero(2));
  EXPECT_LT((J - Eigen::Matrix2d::Identity() - warp.gradient()).cwiseAbs().maxCoeff(), 1e-9);
}

}  // namespace
}  // namespace plumbline
