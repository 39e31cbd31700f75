#include "match/internal/normal_equations.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "match/correlation_image.h"
#include "match/internal/bspline.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline::internal {
namespace {

constexpr ImageSize kSize{80, 70};
constexpr int kRadius = 12;
const Eigen::Vector2i kAt(41, 33);

GrayImage Speckle(const Eigen::Vector2d& shift, double gain = 1) {
  testing::RenderedSpeckleOptions options;
  options.contrast = gain;
  options.mean_grey = 120 + 20 * (1 - gain);
  return testing::RenderSpeckle(
      kSize, [&](const Eigen::Vector2d& p) -> Eigen::Vector2d { return p - shift; }, 1, 5, options);
}

// A subset, its sums, and the same problem written down densely in double.
struct Problem {
  CorrelationImage reference, deformed;
  PackedSubset subset;
  int count;
  ReferenceSums sums;
  ProductSums products, noise;
  TargetSums target;
  Eigen::MatrixXd J;  // steepest-descent images, a row a pixel
  Eigen::VectorXd f, g;

  Problem(int order, Prefilter prefilter, const Eigen::Vector2d& shift)
      : reference(Speckle({0, 0}), {Interpolation::kQuintic, prefilter}),
        deformed(Speckle(shift, 0.8), {Interpolation::kQuintic, prefilter}) {
    count = Pack({&reference.grey(), &reference.gradient_x(), &reference.gradient_y(),
                  &reference.noise_gradient_x(), &reference.noise_gradient_y(), nullptr},
                 SubsetOutline::Square(kRadius), kAt.x(), kAt.y(), 100, subset);
    sums = SumReference(subset, order);
    products = SumProducts(subset, subset.gradient_x, subset.gradient_y, order);
    noise = SumProducts(subset, subset.noise_x, subset.noise_y, order);
    TargetPixels pixels;
    pixels.coefficients = deformed.coefficients() + kAt.y() * deformed.stride() + kAt.x();
    pixels.stride = deformed.stride();
    pixels.grey_offset = 100;
    pixels.warp_x[1] = pixels.warp_y[2] = 1;
    target = SumTarget(subset, pixels, order);
    const int terms = kShapeTerms[order];
    J.resize(count, 2 * terms);
    f.resize(count);
    g.resize(count);
    int i = 0;
    for (int y = -kRadius; y <= kRadius; ++y) {
      for (int x = -kRadius; x <= kRadius; ++x, ++i) {
        Eigen::VectorXd m(6);
        m << 1, x, y, x * x, x * y, y * y;
        const int row = kAt.y() + y, column = kAt.x() + x;
        J.row(i) << static_cast<double>(reference.gradient_x()(row, column)) *
                        m.head(terms).transpose(),
            static_cast<double>(reference.gradient_y()(row, column)) * m.head(terms).transpose();
        f[i] = reference.grey()(row, column);
        g[i] = deformed.grey()(row, column);
      }
    }
  }
  NormalEquations Equations(int order) const { return {order, count, sums, products}; }

  // g = J (gain delta) + gain f + offset.
  Eigen::MatrixXd DesignMatrix() const {
    Eigen::MatrixXd A(count, J.cols() + 2);
    A << J, f, Eigen::VectorXd::Ones(count);
    return A;
  }
};

Eigen::VectorXd Unknowns(const SubsetWarp& warp, int order) {
  const int terms = kShapeTerms[order];
  Eigen::VectorXd unknowns(2 * terms);
  unknowns << warp.c.row(0).head(terms).transpose(), warp.c.row(1).head(terms).transpose();
  return unknowns;
}

class OfOrder : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(NormalEquations, OfOrder, ::testing::Values(0, 1, 2));

TEST_P(OfOrder, StepIsTheDenseLeastSquaresSolutionWithGainAndOffset) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kLowPass, {0.4, -0.3});
  const NormalEquations equations = problem.Equations(order);
  ASSERT_TRUE(equations.solvable());
  EXPECT_EQ(equations.unknowns(), problem.J.cols());
  const Eigen::MatrixXd A = problem.DesignMatrix();
  const Eigen::VectorXd solution = A.colPivHouseholderQr().solve(problem.g);
  const double gain = solution[problem.J.cols()];
  const Eigen::VectorXd expected = solution.head(problem.J.cols()) / gain;
  SubsetWarp step;
  ASSERT_TRUE(equations.Step(equations.Evaluate(problem.target), 0, step));
  const Eigen::VectorXd actual = Unknowns(step, order);
  for (Eigen::Index k = 0; k < actual.size(); ++k) {
    const double reach = problem.J.col(0).norm() / problem.J.col(k).norm();  // of the unit
    EXPECT_NEAR(actual[k], expected[k], 1e-4 * std::max(reach, std::abs(expected[k]))) << k;
  }
}

TEST_P(OfOrder, FitIsThatOfGainAndOffsetAlone) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kNone, {0.4, -0.3});
  const auto fit = problem.Equations(order).Evaluate(problem.target);
  const Eigen::VectorXd f = problem.f.array() - problem.f.mean();
  const Eigen::VectorXd g = problem.g.array() - problem.g.mean();
  const double gain = f.dot(g) / f.squaredNorm();
  EXPECT_NEAR(fit.zncc, f.dot(g) / (f.norm() * g.norm()), 1e-5);
  EXPECT_NEAR(fit.gain, gain, 1e-5);
  EXPECT_NEAR(fit.mean, problem.g.mean() - 100, 1e-3);
  EXPECT_NEAR(fit.residual, (g - gain * f).squaredNorm(), 1e-3 * g.squaredNorm());
}

TEST_P(OfOrder, ForeseesWhatTheStepLeavesOfTheResidual) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kLowPass, {0.4, -0.3});
  const NormalEquations equations = problem.Equations(order);
  const auto fit = equations.Evaluate(problem.target), after = equations.Foreseen(fit);
  const Eigen::MatrixXd A = problem.DesignMatrix();
  const double left = (problem.g - A * A.colPivHouseholderQr().solve(problem.g)).squaredNorm();
  EXPECT_NEAR(after.residual, left, 1e-4 * fit.energy);
  EXPECT_NEAR(after.zncc, std::sqrt(1 - left / fit.energy), 1e-4);
  EXPECT_LT(after.residual, 0.5 * fit.residual);
}

TEST_P(OfOrder, DampedStepIsShorterAndOfTheDampedSystem) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kLowPass, {0.4, -0.3});
  const NormalEquations equations = problem.Equations(order);
  const auto fit = equations.Evaluate(problem.target);
  const Eigen::VectorXd f = problem.f.array() - problem.f.mean();
  Eigen::MatrixXd J = problem.J.rowwise() - problem.J.colwise().mean();
  J -= f * (f.transpose() * J) / f.squaredNorm();
  Eigen::MatrixXd H = J.transpose() * J;
  H.diagonal() *= 1.5;
  const Eigen::VectorXd solution = H.ldlt().solve(J.transpose() * problem.g);
  const Eigen::VectorXd left = problem.g - problem.J * solution;
  const double gain = f.dot(left) / f.squaredNorm();
  SubsetWarp step, free;
  ASSERT_TRUE(equations.Step(fit, 0.5, step));
  ASSERT_TRUE(equations.Step(fit, 0, free));
  EXPECT_LT((Unknowns(step, order) - solution / gain).norm(), 1e-3 * (solution / gain).norm());
  EXPECT_LT(NormalEquations::MeanSquareShift(step, kRadius),
            NormalEquations::MeanSquareShift(free, kRadius));
}

// The unknowns that a covariance is delivered of: displacement and gradient.
std::vector<int> Delivered(int order) {
  if (order == 0) return {0, 1};
  if (order == 1) return {0, 1, 2, 3, 4, 5};
  return {0, 1, 2, 6, 7, 8};
}

TEST_P(OfOrder, CovarianceWithoutAFilterIsTheInverseNormalMatrix) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kNone, {0, 0});
  const Eigen::MatrixXd A = problem.DesignMatrix();
  // Scaled, for the second order's numbers span many powers of ten.
  const Eigen::VectorXd scale = A.colwise().norm().cwiseInverse();
  const Eigen::MatrixXd N = scale.asDiagonal() * (A.transpose() * A) * scale.asDiagonal();
  const Eigen::MatrixXd full = scale.asDiagonal() * N.inverse() * scale.asDiagonal();
  const auto covariance = problem.Equations(order).CovariancePerVariance(nullptr);
  const std::vector<int> delivered = Delivered(order);
  ASSERT_EQ(covariance.rows(), static_cast<Eigen::Index>(delivered.size()));
  for (std::size_t i = 0; i < delivered.size(); ++i) {
    for (std::size_t k = 0; k < delivered.size(); ++k) {
      const int a = delivered[i], b = delivered[k];
      EXPECT_NEAR(covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)),
                  full(a, b), 1e-4 * std::sqrt(full(a, a) * full(b, b)))
          << i << ' ' << k;
    }
  }
}

// The weights of the raw pixels: those of the filtered ones, filtered; written down pixel by pixel.
TEST_P(OfOrder, CovarianceWithAFilterIsThatOfTheRawPixels) {
  const int order = GetParam();
  const Problem problem(order, Prefilter::kLowPass, {0, 0});
  const Eigen::MatrixXd A = problem.DesignMatrix();
  const Eigen::MatrixXd W = A.colPivHouseholderQr()
                                .solve(Eigen::MatrixXd::Identity(problem.count, problem.count))
                                .topRows(problem.J.cols());
  const std::vector<float> taps = LowPassTaps();
  const auto covariance = problem.Equations(order).CovariancePerVariance(&problem.noise);
  Eigen::MatrixXd raw(problem.J.cols(), kSize.width * kSize.height);
  for (Eigen::Index k = 0; k < raw.rows(); ++k) {
    Image<float> weights(kSize, 0);
    int i = 0;
    for (int y = -kRadius; y <= kRadius; ++y) {
      for (int x = -kRadius; x <= kRadius; ++x, ++i) {
        weights(kAt.y() + y, kAt.x() + x) = static_cast<float>(W(k, i));
      }
    }
    const Image<float> filtered = FilterSeparably(weights, taps, taps);
    raw.row(k) = Eigen::Map<const Eigen::RowVectorXf>(filtered.data(), raw.cols()).cast<double>();
  }
  const Eigen::MatrixXd expected = raw * raw.transpose();
  const std::vector<int> delivered = Delivered(order);
  for (std::size_t i = 0; i < delivered.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    // The border of the subset, where the filter's answer is cut, is left out by the formula.
    EXPECT_NEAR(std::sqrt(covariance(at, at) / expected(delivered[i], delivered[i])), 1, 0.08) << i;
  }
}

TEST(NormalEquations, SteepestDescentImagesAreTheDerivativesOfTheWarpedImage) {
  const Problem problem(2, Prefilter::kLowPass, {0, 0});
  for (const int pixel : {0, 12, 137, 312, 400, 624}) {
    const Eigen::Vector2d offset(pixel % 25 - kRadius, pixel / 25 - kRadius);
    const Eigen::MatrixXd J = testing::NumericJacobian(
        [&](const Eigen::VectorXd& unknowns) -> Eigen::VectorXd {
          SubsetWarp warp;
          warp.c << unknowns.head(6).transpose(), unknowns.tail(6).transpose();
          return Eigen::VectorXd::Constant(
              1, problem.reference.Value(kAt.cast<double>() + warp.Apply(offset)));
        },
        Eigen::VectorXd::Zero(12), 1e-5);
    const double scale = 1 + problem.J.row(pixel).cwiseAbs().maxCoeff();
    EXPECT_LT((J.row(0) - problem.J.row(pixel)).cwiseAbs().maxCoeff(), 1e-3 * scale) << pixel;
  }
}

TEST(NormalEquations, AreNotSolvableWithoutTextureInTwoDirections) {
  const auto solvable = [](const std::function<double(int, int)>& grey, int order) {
    GrayImage image{Image<std::uint16_t>(kSize), 8};
    for (int y = 0; y < kSize.height; ++y) {
      for (int x = 0; x < kSize.width; ++x) {
        image.grey(y, x) = static_cast<std::uint16_t>(std::lround(grey(x, y)));
      }
    }
    const CorrelationImage prepared(image);
    PackedSubset subset;
    const int count = Pack({&prepared.grey(), &prepared.gradient_x(), &prepared.gradient_y(),
                            nullptr, nullptr, nullptr},
                           SubsetOutline::Square(kRadius), kAt.x(), kAt.y(),
                           prepared.grey()(kAt.y(), kAt.x()), subset);
    return NormalEquations(order, count, SumReference(subset, order),
                           SumProducts(subset, subset.gradient_x, subset.gradient_y, order))
        .solvable();
  };
  for (const int order : {0, 1, 2}) {
    EXPECT_FALSE(solvable([](int, int) { return 77; }, order)) << order;
    EXPECT_FALSE(solvable([](int x, int) { return 100 + 50 * std::sin(0.8 * x); }, order));
    EXPECT_FALSE(solvable([](int x, int) { return x % 10 < 5 ? 0 : 255; }, order));
    EXPECT_TRUE(
        solvable([](int x, int y) { return (x * x * 7 + y * y * 13 + x * y * 3) % 256; }, order));
  }
}

TEST(NormalEquations, MeanSquareShiftIsThatOfTheSquare) {
  SubsetWarp step;
  step.c << 0.3, 0.02, -0.03, 0.004, -0.002, 0.003, -0.1, 0.01, 0.05, -0.001, 0.005, 0.002;
  double sum = 0;
  constexpr int kFine = 400;
  for (int i = 0; i < kFine; ++i) {
    for (int k = 0; k < kFine; ++k) {
      const Eigen::Vector2d at(16 * (2 * (i + 0.5) / kFine - 1), 16 * (2 * (k + 0.5) / kFine - 1));
      sum += (step.Apply(at) - at).squaredNorm();
    }
  }
  EXPECT_NEAR(NormalEquations::MeanSquareShift(step, 16), sum / (kFine * kFine), 1e-3);
}

}  // namespace
}  // namespace plumbline::internal
