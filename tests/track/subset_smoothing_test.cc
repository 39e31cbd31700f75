#include "track/subset_smoothing.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <functional>
#include <numbers>
#include <utility>

#include "tests/support/subset_noise.h"
#include "track/surface_motion.h"

namespace plumbline {
namespace {

using Motion = std::function<double(double x_px, double y_px)>;

constexpr int kStepPx = 8, kSubsetPx = 33;
constexpr ImageSize kGrid{30, 26};
constexpr double kMmPerPx = 0.2, kSigma_px = 0.01;

// The weights of a subset's pixels in the value at its centre: what correlation of an ideal speckle
// does.
Eigen::MatrixXd PixelWeights(int order) {
  const int radius = kSubsetPx / 2;
  const int terms = order == 2 ? 6 : 3;
  Eigen::MatrixXd J(kSubsetPx * kSubsetPx, terms);
  for (int k = 0; k < J.rows(); ++k) {
    const double x = (k % kSubsetPx - radius) / 16.0, y = (k / kSubsetPx - radius) / 16.0;
    Eigen::Matrix<double, 6, 1> row;
    row << 1, x, y, x * x, x * y, y * y;
    J.row(k) = row.head(terms);
  }
  const Eigen::VectorXd weights =
      J * (J.transpose() * J).ldlt().solve(Eigen::VectorXd::Unit(terms, 0));
  return weights.reshaped(kSubsetPx, kSubsetPx);  // (x, y)
}

// A pair in which the left image moves along x by what a subset makes of a motion, and the point
// with it along x and in depth; the right one stands still.
struct Pair {
  StereoField field, at_rest;
  SurfaceState instant;
  Image<Eigen::Vector3f> cov_px2{kGrid, Eigen::Vector3f(1, 0, 1)};
  Image<double> error_mm{kGrid, 0};  // of the depth, without noise

  Pair(int order, const Motion& motion, bool noise = false, std::uint32_t seed = 1) {
    const Eigen::MatrixXd weights = PixelWeights(order);
    const int radius = kSubsetPx / 2;
    const int width = kStepPx * kGrid.width + 2 * radius;
    const int height = kStepPx * kGrid.height + 2 * radius;
    Eigen::MatrixXd seen(width, height);
    testing::NormalDeviates normal(seed);
    // So that a subset's displacement has the sigma that is claimed.
    const double pixel_sigma = noise ? kSigma_px / weights.norm() : 0;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        seen(x, y) = motion(x - radius, y - radius) + pixel_sigma * normal();
      }
    }
    field.left = PlanarField(kGrid, {radius, radius}, kStepPx);
    field.left.subset_px = kSubsetPx;
    field.left.order = order;
    field.right = at_rest.left = at_rest.right = field.left;
    const float sigma = static_cast<float>(kSigma_px);
    instant.point_mm = Image<Eigen::Vector3d>(kGrid, Eigen::Vector3d::Zero());
    Eigen::Matrix<float, 3, 2> along = Eigen::Matrix<float, 3, 2>::Zero();
    along(0, 0) = along(1, 1) = along(2, 0) = static_cast<float>(kMmPerPx);
    instant.d_left = instant.d_right = Image<Eigen::Matrix<float, 3, 2>>(kGrid, along);
    instant.scale_left = Image<float>(kGrid, sigma);
    instant.scale_right = Image<float>(kGrid, 0);
    instant.share_left = instant.share_right = Image<float>(kGrid, 0.5F);
    for (int r = 0; r < kGrid.height; ++r) {
      for (int c = 0; c < kGrid.width; ++c) {
        const double u =
            seen.block(kStepPx * c, kStepPx * r, kSubsetPx, kSubsetPx).cwiseProduct(weights).sum();
        for (PlanarField* match : {&field.left, &field.right, &at_rest.left, &at_rest.right}) {
          match->displacement_px(r, c) = {match == &field.left ? u : 0, 0};
          match->gradient(r, c).setZero();
          match->status(r, c) = Status::kOk;
        }
        error_mm(r, c) = kMmPerPx * (u - motion(kStepPx * c, kStepPx * r));
      }
    }
  }

  Image<Eigen::Matrix<float, 6, 1>> LeftOut() const {
    return SubsetSmoothing(field.left).LeftOut(at_rest, field, instant, cov_px2);
  }
};

double Wave(double x_px, double y_px, double period_px) {
  return 0.3 * std::sin(2 * std::numbers::pi * (x_px + 0.4 * y_px) / period_px);
}

TEST(SubsetSmoothing, LeavesOutNothingOfWhatShapeFunctionsFollow) {
  const auto plane = [](double x, double y) { return 0.5 + 0.01 * x - 0.02 * y; };
  const auto bent = [&](double x, double y) { return plane(x, y) + 1e-4 * x * y - 2e-4 * y * y; };
  for (const auto& [order, motion] : {std::pair<int, Motion>{1, plane}, {2, bent}}) {
    const auto all = Pair(order, motion).LeftOut();
    for (const auto& left_out : all.values()) {
      EXPECT_LT(left_out.cwiseAbs().maxCoeff(), 1e-9) << "order " << order;
    }
  }
}

TEST(SubsetSmoothing, SaysHowFarShapeFunctionsAreOffAWave) {
  for (const int order : {1, 2}) {
    for (const double period_px : {70.0, 90.0, 130.0}) {
      const Pair pair(order, [&](double x, double y) { return Wave(x, y, period_px); });
      const auto left_out = pair.LeftOut();
      double errors = 0, claimed = 0, across = 0;
      for (std::size_t i = 0; i < left_out.pixel_count(); ++i) {
        errors += pair.error_mm.data()[i] * pair.error_mm.data()[i];
        claimed += static_cast<double>(left_out.data()[i][5]);
        across += static_cast<double>(left_out.data()[i][3]);
      }
      const double in_noise =
          std::sqrt(errors / static_cast<double>(left_out.pixel_count())) / (kMmPerPx * kSigma_px);
      const double ratio = std::sqrt(claimed / errors);
      std::printf("order %d, period %.0f px: error %.2f sigma of noise, claimed over it %.2f\n",
                  order, period_px, in_noise, ratio);
      if (in_noise < 0.2) continue;  // nothing that noise would not hide
      EXPECT_GT(ratio, 0.65) << order << ", " << period_px;
      EXPECT_LT(ratio, 1.6) << order << ", " << period_px;
      EXPECT_LT(across, 1e-3 * claimed);  // nothing moves along y
    }
  }
}

TEST(SubsetSmoothing, AddsNextToNothingToNoise) {
  for (const int order : {1, 2}) {
    const Pair pair(
        order, [](double, double) { return 0.0; }, true, 7);
    const auto noise = CovarianceOf(pair.instant, pair.cov_px2);
    double share = 0;
    const auto left_out = pair.LeftOut();
    for (std::size_t i = 0; i < left_out.pixel_count(); ++i) {
      share += static_cast<double>(left_out.data()[i][5] / noise.data()[i][5]);
    }
    share /= static_cast<double>(left_out.pixel_count());
    std::printf("order %d: %.3f of the noise's variance\n", order, share);
    EXPECT_LT(share, 0.1) << order;
  }
}

TEST(SubsetSmoothing, TakesTheCurvatureBetweenTheCamerasFromThePairAtRest) {
  const auto curved = [](double x, double y) { return 2e-4 * (x * x + y * y); };
  Pair pair(1, curved);
  std::swap(pair.field.left.displacement_px, pair.field.right.displacement_px);
  EXPECT_GT(pair.LeftOut()(9, 9)[5], 1e-6F);
  pair.at_rest.right = pair.field.right;
  const auto all = pair.LeftOut();
  for (const auto& left_out : all.values()) {
    EXPECT_LT(left_out.cwiseAbs().maxCoeff(), 1e-9);
  }
}

TEST(SubsetSmoothing, GoesByThePointsThatAreThere) {
  Pair pair(2, [](double x, double y) { return Wave(x, y, 80); });
  const auto whole = pair.LeftOut();
  // A hole; and a column by itself, about which too little is known.
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      const bool hole = r > 8 && r < 14 && c > 8 && c<14, beside = c> 22 && c != 26;
      if (!hole && !beside) continue;
      pair.field.left.status(r, c) = Status::kLowCorrelation;
      pair.instant.point_mm(r, c).setConstant(std::nan(""));
    }
  }
  const auto some = pair.LeftOut();
  EXPECT_FALSE(some(10, 10).allFinite());
  EXPECT_NEAR(some(3, 3)[5], whole(3, 3)[5], 1e-7);
  EXPECT_GT(some(10, 7)[5], 0.2F * whole(10, 7)[5]);
  EXPECT_LT(some(10, 7)[5], 5 * whole(10, 7)[5]);
  EXPECT_EQ(some(10, 26)[5], 0);
}

TEST(SubsetSmoothing, GoesIntoTheErrorsOfPointsAndMotions) {
  Pair pair(2, [](double x, double y) { return Wave(x, y, 80); });
  SurfaceState before = pair.instant;
  const auto noise = CovarianceOf(pair.instant, pair.cov_px2);
  const auto alone = MotionBetween(before, pair.instant, pair.cov_px2);
  pair.instant.cov_left_out_mm2 = pair.LeftOut();
  const Eigen::Vector3f left_out_zz = pair.instant.cov_left_out_mm2(9, 9).tail<3>();
  EXPECT_FLOAT_EQ(CovarianceOf(pair.instant, pair.cov_px2)(9, 9)[5],
                  noise(9, 9)[5] + left_out_zz[2]);
  EXPECT_FLOAT_EQ(MotionBetween(before, pair.instant, pair.cov_px2).cov_random_mm2(9, 9)[5],
                  alone.cov_random_mm2(9, 9)[5] + left_out_zz[2]);
  // Told in another frame it turns along: z becomes x.
  MeasurementFrame turned;
  turned.frame_from_rig.rotation = RotationFromVector({0, std::numbers::pi / 2, 0});
  const SurfaceState there = InFrame(pair.instant, turned);
  EXPECT_FLOAT_EQ(there.cov_left_out_mm2(9, 9)[0], left_out_zz[2]);
}

}  // namespace
}  // namespace plumbline
