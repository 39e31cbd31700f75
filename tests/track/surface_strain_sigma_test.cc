#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <string>
#include <utility>

#include "match/planar_field.h"
#include "tests/support/subset_noise.h"
#include "tests/track/surfaces.h"
#include "track/surface_strain.h"

namespace plumbline {
namespace {

using testing::AddMatches;
using testing::AddModes;
using testing::AllOk;
using testing::GaugesOf;
using testing::InstantOf;
using testing::kGrid;
using testing::kMeasures;
using testing::kStepPx;
using testing::kSubsetPx;
using testing::Modes;
using testing::NormalDeviates;
using testing::OnLoadedSaddle;
using testing::OnSaddle;
using testing::Remove;

struct NoiseCase {
  int window_points, order;
  StrainMeasure measure;
  bool holes, along_x;
  GaugeWeights weights = GaugeWeights::kEqual;
};

class SigmaOfSurfaceStrain : public ::testing::TestWithParam<NoiseCase> {};

TEST_P(SigmaOfSurfaceStrain, HoldsOverDrawsOfTheMatches) {
  constexpr ImageSize kSmallGrid{14, 13};
  constexpr int kDraws = 600;
  const NoiseCase& given = GetParam();
  const int points = kSmallGrid.width * kSmallGrid.height;
  const NeighbourCorrelation neighbours =
      NeighbourCorrelation::OfOverlap(kSmallGrid, kStepPx, kSubsetPx, 1);
  NormalDeviates draw(17);
  // Of a match with a scale of 1: S R S, factored.
  Image<Eigen::Vector3f> cov_px2(kSmallGrid, Eigen::Vector3f::Zero());
  for (Eigen::Vector3f& cov : cov_px2.values())
    cov =
        1e-4F * Eigen::Vector3d(0.7 + 0.6 * draw.Uniform(), 0, 1.5 + draw.Uniform()).cast<float>();
  Eigen::MatrixXd cov(2 * points, 2 * points);
  for (int p = 0; p < points; ++p) {
    for (int q = 0; q < points; ++q) {
      const int width = kSmallGrid.width;
      const Eigen::Matrix2f R =
          neighbours.Between(p / width, p % width, q / width - p / width, q % width - p % width);
      for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j)
          cov(2 * p + i, 2 * q + j) =
              std::sqrt(static_cast<double>(cov_px2.data()[p][2 * i]) * cov_px2.data()[q][2 * j]) *
              R(i, j);
      }
    }
  }
  const Eigen::MatrixXd L = cov.llt().matrixL();
  const auto noise = [&]() -> Eigen::VectorXd {
    Eigen::VectorXd z(2 * points);
    for (double& value : z) value = draw();
    return L * z;
  };

  SurfaceState reference = InstantOf(kSmallGrid, OnSaddle);
  SurfaceState now = InstantOf(kSmallGrid, OnLoadedSaddle);
  AddMatches(reference, true);
  AddMatches(now, false);
  Image<Status> status = AllOk(kSmallGrid);
  if (given.holes) {
    for (const auto& [r, c] : {std::pair{3, 4}, {8, 8}, {9, 8}, {11, 3}}) Remove(reference, r, c);
    for (const auto& [r, c] : {std::pair{5, 9}, {6, 5}, {2, 11}})
      status(r, c) = Status::kLowTexture;
  }
  SurfaceStrainOptions options;
  options.window_points = given.window_points;
  options.order = given.order;
  options.measure = given.measure;
  options.weights = given.weights;
  if (given.along_x) options.x_direction = Eigen::Vector3d(1, 1, -0.5);
  const auto measure = [&](const SurfaceState& before, const SurfaceState& after) {
    return SurfaceGauges(before, cov_px2, neighbours, kStepPx, kSubsetPx, options)
        .Strain(after, status);
  };
  const SurfaceStrain truth = measure(reference, now);

  double nees = 0, count = 0, inside = 0;
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::VectorXd common = noise();
    const auto disturb = [&](SurfaceState& instant, const Image<Eigen::Matrix<float, 3, 2>>& D,
                             const Image<float>& scale, const Image<float>& share) {
      const Eigen::VectorXd own = noise();
      for (int p = 0; p < points; ++p) {
        const double of_reference = share.data()[p];
        const Eigen::Vector2d error =
            scale.data()[p] * (std::sqrt(of_reference) * common.segment<2>(2 * p) +
                               std::sqrt(1 - of_reference) * own.segment<2>(2 * p));
        instant.point_mm.data()[p] += D.data()[p].cast<double>() * error;
      }
    };
    SurfaceState before = reference, after = now;
    disturb(before, reference.d_right, reference.scale_right, reference.share_right);
    disturb(after, now.d_left, now.scale_left, now.share_left);
    disturb(after, now.d_right, now.scale_right, now.share_right);
    const SurfaceStrain strain = measure(before, after);
    for (std::size_t p = 0; p < strain.status.pixel_count(); ++p) {
      if (strain.status.data()[p] != Status::kOk) continue;
      const Eigen::Vector3d error =
          (strain.strain.data()[p] - truth.strain.data()[p]).cast<double>();
      nees += error.dot(CovarianceOf(strain.cov_strain.data()[p]).inverse() * error);
      const auto interval = [&](double off, double sigma) {
        inside += std::abs(off) < 1.959964 * sigma ? 0.25 : 0;
      };
      interval(strain.principal.data()[p][0] - truth.principal.data()[p][0],
               strain.sigma_principal_random.data()[p][0]);
      interval(strain.angle_rad.data()[p] - truth.angle_rad.data()[p],
               strain.sigma_angle_random_rad.data()[p]);
      interval(strain.max_shear.data()[p] - truth.max_shear.data()[p],
               strain.sigma_max_shear_random.data()[p]);
      interval(strain.von_mises.data()[p] - truth.von_mises.data()[p],
               strain.sigma_von_mises_random.data()[p]);
      count += 1;
    }
  }
  ASSERT_GT(count, 40 * kDraws);
  RecordProperty("nees", std::to_string(nees / count));
  RecordProperty("coverage", std::to_string(inside / count));
  EXPECT_NEAR(nees / count, 3, 0.2);
  EXPECT_GT(inside / count, 0.93);
  EXPECT_LT(inside / count, 0.97);
}

INSTANTIATE_TEST_SUITE_P(
    Gauges, SigmaOfSurfaceStrain,
    ::testing::Values(NoiseCase{7, 1, StrainMeasure::kGreenLagrange, false, false},
                      NoiseCase{7, 1, StrainMeasure::kAlmansi, true, false},
                      NoiseCase{5, 2, StrainMeasure::kHencky, true, true},
                      NoiseCase{7, 3, StrainMeasure::kGreenLagrange, true, true},
                      NoiseCase{7, 1, StrainMeasure::kGreenLagrange, true, false,
                                GaugeWeights::kInverseVariance}));

TEST(SigmaOfSurfaceStrain, IsSmallerWhereSurePointsCountMore) {
  SurfaceState reference = InstantOf(kGrid, OnSaddle), now = InstantOf(kGrid, OnLoadedSaddle);
  AddMatches(reference, true);
  AddMatches(now, false);
  // Every third column has little texture. Subsets do not overlap.
  Image<Eigen::Vector3f> cov_px2(kGrid, Eigen::Vector3f(1e-4F, 0, 1e-4F));
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; c += 3) cov_px2(r, c) *= 25;
  }
  const auto variance = [&](GaugeWeights weights) {
    SurfaceStrainOptions options;
    options.weights = weights;
    const SurfaceGauges gauges(reference, cov_px2,
                               NeighbourCorrelation::OfOverlap(kGrid, 30, kSubsetPx, 1), 30,
                               kSubsetPx, options);
    return gauges.Strain(now, AllOk(kGrid)).cov_strain(10, 12)[0];
  };
  EXPECT_LT(variance(GaugeWeights::kInverseVariance), 0.5F * variance(GaugeWeights::kEqual));
}

TEST(SigmaOfSurfaceStrain, IsZeroForTheSameMatchesOnceMore) {
  SurfaceState reference = InstantOf(kGrid, OnSaddle);
  AddMatches(reference, true);
  const SurfaceStrain repeated = GaugesOf(reference).Strain(reference, AllOk(kGrid));
  EXPECT_GT(repeated.cov_strain(10, 10)[0], 1e-12F);
  reference.share_right = Image<float>(kGrid, 1);
  const SurfaceStrain same = GaugesOf(reference).Strain(reference, AllOk(kGrid));
  EXPECT_LT(same.cov_strain(10, 10)[0], 1e-9F * repeated.cov_strain(10, 10)[0]);
}

TEST(CalibrationOfSurfaceStrain, IsThatOfMeasuringAgainAlongEachMode) {
  for (const StrainMeasure measure : kMeasures) {
    SurfaceStrainOptions options;
    options.measure = measure;
    if (measure == StrainMeasure::kHencky) options.x_direction = Eigen::Vector3d(1, 1, 0);
    SurfaceState reference = InstantOf(kGrid, OnSaddle), now = InstantOf(kGrid, OnLoadedSaddle);
    AddModes(reference);
    AddModes(now);
    const SurfaceStrain strain = GaugesOf(reference, options).Strain(now, AllOk(kGrid));
    for (const auto& [r, c] : {std::pair{10, 12}, {3, 20}}) {
      Eigen::Matrix<double, 8, 1> variance = Eigen::Matrix<double, 8, 1>::Zero();
      for (const auto& mode : Modes()) {
        const auto along = [&](double sigmas) {
          SurfaceState before = reference, after = now;
          for (Eigen::Vector3d& p : before.point_mm.values()) p += sigmas * mode(p);
          for (Eigen::Vector3d& p : after.point_mm.values()) p += sigmas * mode(p);
          const SurfaceStrain again = GaugesOf(before, options).Strain(after, AllOk(kGrid));
          Eigen::Matrix<double, 8, 1> out;
          out << again.strain(r, c).cast<double>(), again.principal(r, c).cast<double>(),
              again.angle_rad(r, c), again.max_shear(r, c), again.von_mises(r, c);
          return out;
        };
        variance += (0.5 * (along(1) - along(-1))).cwiseAbs2();
      }
      Eigen::Matrix<double, 8, 1> sigma;
      sigma << strain.sigma_calibration(r, c).cast<double>(),
          strain.sigma_principal_calibration(r, c).cast<double>(),
          strain.sigma_angle_calibration_rad(r, c), strain.sigma_max_shear_calibration(r, c),
          strain.sigma_von_mises_calibration(r, c);
      EXPECT_GT(sigma.minCoeff(), 1e-6);
      EXPECT_LT((sigma - variance.cwiseSqrt()).cwiseQuotient(sigma).cwiseAbs().maxCoeff(), 2e-3)
          << sigma.transpose() << '\n'
          << variance.cwiseSqrt().transpose();
    }
  }
}

TEST(CalibrationOfSurfaceStrain, IsNoneForAModeThatMovesTheFrameRigidly) {
  for (const StrainMeasure measure : kMeasures) {
    SurfaceStrainOptions options;
    options.measure = measure;
    SurfaceState reference = InstantOf(kGrid, OnSaddle), now = InstantOf(kGrid, OnLoadedSaddle);
    for (SurfaceState* instant : {&reference, &now}) {
      Image<Eigen::Vector3f> along(kGrid, Eigen::Vector3f::Zero());
      for (std::size_t i = 0; i < along.pixel_count(); ++i)
        along.data()[i] = (Eigen::Vector3d(0.01, 0.02, -0.01) +
                           Eigen::Vector3d(1e-3, -2e-3, 1e-3).cross(instant->point_mm.data()[i]))
                              .cast<float>();
      instant->along_modes_mm = {along};
    }
    const SurfaceStrain strain = GaugesOf(reference, options).Strain(now, AllOk(kGrid));
    EXPECT_LT(strain.sigma_calibration(10, 12).maxCoeff(), 1e-8F) << Name(measure);
    EXPECT_LT(strain.sigma_calibration(5, 5).maxCoeff(), 1e-8F) << Name(measure);
  }
}

TEST(CalibrationOfSurfaceStrain, IsUnknownWithoutModes) {
  const SurfaceState reference = InstantOf(kGrid, OnSaddle);
  const SurfaceStrain strain =
      GaugesOf(reference).Strain(InstantOf(kGrid, OnLoadedSaddle), AllOk(kGrid));
  EXPECT_EQ(strain.status(10, 10), Status::kOk);
  EXPECT_TRUE(strain.sigma_calibration(10, 10).array().isNaN().all());
  EXPECT_TRUE(std::isnan(strain.sigma_von_mises_calibration(10, 10)));
  EXPECT_FALSE(std::isnan(strain.sigma_von_mises_random(10, 10)));
}

}  // namespace
}  // namespace plumbline
