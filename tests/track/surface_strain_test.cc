#include "track/surface_strain.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <utility>

#include "calib/error.h"
#include "tests/track/surfaces.h"

namespace plumbline {
namespace {

using testing::AddMatches;
using testing::AddModes;
using testing::AllOk;
using testing::GaugesOf;
using testing::InstantOf;
using testing::kGrid;
using testing::kMeasures;
using testing::kMmPerPx;
using testing::kStepPx;
using testing::kSubsetPx;
using testing::OnLoadedSaddle;
using testing::OnSaddle;
using testing::Remove;
using testing::Surface;

// A cylinder of radius 50 mm, its axis along the rows, bulging towards the camera.
constexpr double kRadiusMm = 50;
Eigen::Vector3d OnCylinder(double arc_mm, double along_mm) {
  const double angle = arc_mm / kRadiusMm;
  return {kRadiusMm * std::sin(angle), along_mm, 400 - kRadiusMm * std::cos(angle)};
}

const Eigen::Isometry3d kMotion =
    Eigen::Translation3d(12, -9, 13) *
    Eigen::AngleAxisd(10 * M_PI / 180, Eigen::Vector3d(1, -2, 0.7).normalized());

TEST(SurfaceStrain, OfARigidMotionIsZeroHoweverCurvedTheSurface) {
  const Surface moved = [](double s, double t) -> Eigen::Vector3d {
    return kMotion * OnSaddle(s, t);
  };
  for (const int order : {1, 2, 3}) {
    for (const StrainMeasure measure : kMeasures) {
      if (measure == StrainMeasure::kSmall) continue;  // it has no large rotations
      SurfaceStrainOptions options;
      options.order = order;
      options.measure = measure;
      SurfaceState now = InstantOf(kGrid, moved);
      Remove(now, 8, 9);
      const SurfaceStrain strain =
          GaugesOf(InstantOf(kGrid, OnSaddle), options).Strain(now, AllOk(kGrid));
      int ok = 0;
      for (int r = 0; r < kGrid.height; ++r) {
        for (int c = 0; c < kGrid.width; ++c) {
          if (strain.status(r, c) != Status::kOk) continue;
          ++ok;
          EXPECT_LT(strain.strain(r, c).cwiseAbs().maxCoeff(), 1e-12F);
        }
      }
      EXPECT_EQ(ok, 21 * 17 - 12 - 1);  // three at each corner
    }
  }
}

// Tangents along columns and rows of a plane tilted by 40 degrees.
const Eigen::Matrix<double, 3, 2> kPlane =
    (Eigen::Matrix<double, 3, 2>() << 1, 0, 0, std::cos(0.7), 0, std::sin(0.7)).finished();

// In the axes e1 = along columns, e2 = against rows.
Surface PlaneDeformedBy(const Eigen::Matrix2d& F) {
  const Eigen::Matrix2d flip = Eigen::Vector2d(1, -1).asDiagonal();
  return [place = Eigen::Matrix<double, 3, 2>(kPlane * flip * F * flip)](
             double s, double t) -> Eigen::Vector3d {
    return Eigen::Vector3d(3, -5, 400) + place * Eigen::Vector2d(s, t);
  };
}

const Eigen::Matrix2d kStretchAndShear = (Eigen::Matrix2d() << 1.12, 0.05, -0.03, 0.92).finished();

TEST(SurfaceStrain, IsExactOnATiltedPlaneForAllMeasures) {
  // Tilted further, about an axis in the plane: the local axes go along.
  const Eigen::AngleAxisd tilt(0.4, kPlane * Eigen::Vector2d(0.6, 0.8));
  const Surface deformed = PlaneDeformedBy(kStretchAndShear);
  for (const Surface& now : {deformed, Surface([&](double s, double t) -> Eigen::Vector3d {
                               return tilt * deformed(s, t);
                             })}) {
    for (const StrainMeasure measure : kMeasures) {
      SurfaceStrainOptions options;
      options.measure = measure;
      const SurfaceStrain strain =
          GaugesOf(InstantOf(kGrid, PlaneDeformedBy(Eigen::Matrix2d::Identity())), options)
              .Strain(InstantOf(kGrid, now), AllOk(kGrid));
      const Eigen::Vector3d expected =
          StrainOf(kStretchAndShear - Eigen::Matrix2d::Identity(), measure).strain;
      const StrainInvariants invariants = InvariantsOf(expected);
      for (int r = 3; r < kGrid.height - 3; ++r) {
        for (int c = 3; c < kGrid.width - 3; ++c) {
          ASSERT_EQ(strain.status(r, c), Status::kOk);
          EXPECT_LT((strain.strain(r, c).cast<double>() - expected).norm(), 1e-7);
          EXPECT_LT((strain.principal(r, c).cast<double>() - invariants.principal).norm(), 1e-7);
          EXPECT_NEAR(strain.angle_rad(r, c), invariants.angle_rad, 1e-6);
          EXPECT_NEAR(strain.max_shear(r, c), invariants.max_shear, 1e-7);
          EXPECT_NEAR(strain.von_mises(r, c), invariants.von_mises, 1e-7);
        }
      }
      EXPECT_EQ(strain.vsg_px, 8 * kStepPx + kSubsetPx);
      EXPECT_NEAR(strain.vsg_mm, kMmPerPx * strain.vsg_px, 1e-9);
    }
  }
}

TEST(SurfaceStrain, IsThatOfACylinderStretchedAndTwisted) {
  Eigen::Matrix2d F;  // around, along: axes e1, e2
  F << 1.04, 0, -0.03, 0.97;
  const Surface now = [&](double arc, double along) {
    // The twist goes against growing rows.
    return OnCylinder(F(0, 0) * arc, F(1, 1) * along - F(1, 0) * arc);
  };
  for (const StrainMeasure measure : kMeasures) {
    SurfaceStrainOptions options;
    options.measure = measure;
    const SurfaceGauges gauges = GaugesOf(InstantOf(kGrid, OnCylinder), options);
    const SurfaceStrain strain = gauges.Strain(InstantOf(kGrid, now), AllOk(kGrid));
    const Eigen::Vector3d expected = StrainOf(F - Eigen::Matrix2d::Identity(), measure).strain;
    for (const auto& [r, c] : {std::pair{10, 12}, {10, 4}, {4, 20}}) {
      ASSERT_EQ(strain.status(r, c), Status::kOk);
      // Chords against arcs over the gauge, and the axes turn by 0.01 rad with the surface.
      EXPECT_LT((strain.strain(r, c).cast<double>() - expected).cwiseAbs().maxCoeff(), 2e-5)
          << Name(measure) << '\n'
          << strain.strain(r, c) << '\n'
          << expected;
    }
    const double angle = kMmPerPx * kStepPx * (4 - 12) / kRadiusMm;
    Eigen::Matrix3d axes;
    axes << std::cos(angle), 0, std::sin(angle), 0, -1, 0, std::sin(angle), 0, -std::cos(angle);
    EXPECT_LT((gauges.axes()(10, 4).cast<double>() - axes).norm(), 1e-6);
    EXPECT_TRUE(gauges.axes()(0, 0).array().isNaN().all());
  }
}

TEST(SurfaceStrain, TurnsWithTheXDirectionAsATensor) {
  const SurfaceState reference = InstantOf(kGrid, PlaneDeformedBy(Eigen::Matrix2d::Identity()));
  SurfaceState now = InstantOf(kGrid, PlaneDeformedBy(kStretchAndShear));
  now.d_right = Image<Eigen::Matrix<float, 3, 2>>(
      kGrid, (Eigen::Matrix<float, 3, 2>() << 0.05F, 0.01F, 0, 0.1F, 0.3F, 0.1F).finished());
  const SurfaceStrain along = GaugesOf(reference).Strain(now, AllOk(kGrid));
  const double angle = 0.6;
  SurfaceStrainOptions options;
  // From e1 towards e2, which points against rows; what stands on the plane does not count.
  const Eigen::Vector3d normal = kPlane.col(1).cross(kPlane.col(0));
  options.x_direction = std::cos(angle) * kPlane.col(0) - std::sin(angle) * kPlane.col(1) + normal;
  const SurfaceStrain turned = GaugesOf(reference, options).Strain(now, AllOk(kGrid));
  const Eigen::Matrix2d Q = Eigen::Rotation2Dd(angle).toRotationMatrix();
  const Eigen::Vector3f& e = along.strain(10, 10);
  const Eigen::Matrix2d E = (Eigen::Matrix2d() << e[0], e[2], e[2], e[1]).finished();
  const Eigen::Matrix2d expected = Q.transpose() * E * Q;
  const Eigen::Vector3f& seen = turned.strain(10, 10);
  EXPECT_NEAR(seen[0], expected(0, 0), 1e-7);
  EXPECT_NEAR(seen[1], expected(1, 1), 1e-7);
  EXPECT_NEAR(seen[2], expected(0, 1), 1e-7);
  EXPECT_NEAR(turned.angle_rad(10, 10), along.angle_rad(10, 10) - angle, 1e-6);
  EXPECT_NEAR(turned.sigma_principal_random(10, 10)[0], along.sigma_principal_random(10, 10)[0],
              1e-6 * along.sigma_principal_random(10, 10)[0]);
}

// Turned about the cylinder's axis, each point has a direction of its own.
TEST(SurfaceStrain, HasItsXAxisAroundALine) {
  const SurfaceState reference = InstantOf(kGrid, OnCylinder);
  const SurfaceState now = InstantOf(kGrid, [](double arc, double along) {
    return OnCylinder(1.05 * arc + 0.02 * along, 0.97 * along);
  });
  // Tilted, so that columns do not go around it.
  const Eigen::Vector3d direction(0.1, 1, 0.2), point(3, -4, 400);
  SurfaceStrainOptions options;
  options.x_around = LineInSpace{point, direction};
  const SurfaceGauges gauges = GaugesOf(reference, options);
  const SurfaceStrain strain = gauges.Strain(now, AllOk(kGrid));
  for (const auto& [r, c] : {std::pair{10, 12}, {6, 5}, {15, 20}}) {
    const Eigen::Vector3d around = direction.cross(reference.point_mm(r, c) - point);
    options.x_around.reset();
    options.x_direction = around;
    const SurfaceGauges alike = GaugesOf(reference, options);
    EXPECT_LT((gauges.axes()(r, c) - alike.axes()(r, c)).norm(), 1e-6F);
    EXPECT_LT((strain.strain(r, c) - alike.Strain(now, AllOk(kGrid)).strain(r, c)).norm(), 1e-7F);
    EXPECT_GT(gauges.axes()(r, c).col(0).cast<double>().dot(around.normalized()), 0.99);
  }
}

TEST(SurfaceStrain, DoesNotExtrapolateAtEdgesAndHoles) {
  SurfaceState reference = InstantOf(kGrid, OnCylinder), now = InstantOf(kGrid, OnCylinder);
  Image<Status> status = AllOk(kGrid);
  Remove(reference, 10, 5);
  Remove(now, 14, 20);
  status(12, 12) = Status::kLowCorrelation;
  for (int r = 0; r < 5; ++r) {
    for (int c = 9; c < 16; ++c) status(r, c) = Status::kOccluded;
  }
  now.d_right(15, 10).setConstant(std::numeric_limits<float>::quiet_NaN());
  const SurfaceStrain strain = GaugesOf(reference).Strain(now, status);
  EXPECT_EQ(strain.status(10, 1), Status::kExtrapolated);
  EXPECT_TRUE(strain.strain(10, 1).array().isNaN().all());
  EXPECT_TRUE(strain.cov_strain(10, 1).array().isNaN().all());
  EXPECT_EQ(strain.status(15, 2), Status::kOk);
  EXPECT_EQ(strain.points(15, 2), 63);
  EXPECT_EQ(strain.points(10, 9), 80 - 1);
  // Points that are missing get nothing from their neighbours, but these go on.
  EXPECT_EQ(strain.status(10, 5), Status::kFailedVerification);
  EXPECT_EQ(strain.status(14, 20), Status::kFailedVerification);
  EXPECT_EQ(strain.status(12, 12), Status::kLowCorrelation);
  EXPECT_EQ(strain.status(3, 12), Status::kOccluded);
  EXPECT_EQ(strain.status(5, 12), Status::kExtrapolated);
  EXPECT_EQ(strain.status(15, 10), Status::kFailedVerification);
  for (const auto& [r, c] : {std::pair{10, 6}, {14, 19}, {12, 13}})
    EXPECT_EQ(strain.status(r, c), Status::kOk);
}

TEST(SurfaceStrain, OfAFrameWithMissingPointsIsThatOfAReferenceWithoutThem) {
  SurfaceState reference = InstantOf(kGrid, OnSaddle), now = InstantOf(kGrid, OnLoadedSaddle);
  AddMatches(reference, true);
  AddMatches(now, false);
  AddModes(reference);
  AddModes(now);
  Image<Status> status = AllOk(kGrid);
  SurfaceState less = reference;
  for (const auto& [r, c] : {std::pair{10, 5}, {3, 18}, {12, 14}, {13, 14}, {12, 15}}) {
    status(r, c) = Status::kLowCorrelation;
    Remove(less, r, c);
  }
  for (const auto& [order, weights] : {std::pair{1, GaugeWeights::kEqual},
                                       {2, GaugeWeights::kEqual},
                                       {3, GaugeWeights::kEqual},
                                       {1, GaugeWeights::kInverseVariance}}) {
    SurfaceStrainOptions options;
    options.order = order;
    options.weights = weights;
    const SurfaceStrain strain = GaugesOf(reference, options).Strain(now, status);
    const SurfaceStrain expected = GaugesOf(less, options).Strain(now, AllOk(kGrid));
    int ok = 0;
    for (std::size_t i = 0; i < strain.status.pixel_count(); ++i) {
      EXPECT_EQ(strain.points.data()[i], expected.points.data()[i]);
      EXPECT_EQ(strain.status.data()[i] == Status::kOk, expected.status.data()[i] == Status::kOk);
      if (strain.status.data()[i] != Status::kOk) continue;
      ++ok;
      EXPECT_LT((strain.strain.data()[i] - expected.strain.data()[i]).norm(), 1e-7F);
      EXPECT_LT((strain.cov_strain.data()[i] - expected.cov_strain.data()[i]).norm(),
                1e-6F * expected.cov_strain.data()[i].norm());
      EXPECT_LT((strain.sigma_calibration.data()[i] - expected.sigma_calibration.data()[i]).norm(),
                1e-5F * expected.sigma_calibration.data()[i].norm());
    }
    EXPECT_EQ(ok, 21 * 17 - 12 - 5);
  }
}

TEST(SurfaceStrain, IsTheSameForAnyNumberOfThreads) {
  constexpr ImageSize kLarge{150, 70};
  SurfaceState reference = InstantOf(kLarge, OnCylinder);
  SurfaceState now = InstantOf(
      kLarge, [](double s, double t) { return OnCylinder(1.02 * s, t + 0.1 * std::sin(s)); });
  AddMatches(reference, true);
  AddMatches(now, false);
  AddModes(reference);
  AddModes(now);
  Image<Status> status = AllOk(kLarge);
  for (int i = 0; i < 50; ++i) status((7 * i) % 70, (31 * i) % 90) = Status::kLowTexture;
  const auto compute = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return GaugesOf(reference).Strain(now, status);
  };
  const SurfaceStrain one = compute(1), four = compute(4);
  EXPECT_EQ(one.status.values(), four.status.values());
  for (std::size_t i = 0; i < one.status.pixel_count(); ++i) {
    if (one.status.data()[i] != Status::kOk) continue;
    EXPECT_EQ(one.strain.data()[i], four.strain.data()[i]);
    EXPECT_EQ(one.cov_strain.data()[i], four.cov_strain.data()[i]);
    EXPECT_EQ(one.sigma_calibration.data()[i], four.sigma_calibration.data()[i]);
  }
}

TEST(SurfaceStrain, IsNoneWithoutASurfaceAsLargeAsTheGauge) {
  for (const ImageSize size : {ImageSize{1, 1}, ImageSize{5, 5}, ImageSize{40, 2}}) {
    const SurfaceState instant = InstantOf(size, OnCylinder);
    const SurfaceStrain strain = GaugesOf(instant).Strain(instant, AllOk(size));
    for (const Status status : strain.status.values()) EXPECT_EQ(status, Status::kExtrapolated);
    EXPECT_TRUE(std::isnan(strain.vsg_mm));
  }
}

TEST(SurfaceStrain, RefusesWhatItCannotUse) {
  const SurfaceState instant = InstantOf(kGrid, OnCylinder);
  for (const int points : {1, 4, -3}) {
    SurfaceStrainOptions options;
    options.window_points = points;
    EXPECT_THROW((void)GaugesOf(instant, options), UsageError);
  }
  SurfaceStrainOptions options;
  options.x_direction = Eigen::Vector3d::Zero();
  EXPECT_THROW((void)GaugesOf(instant, options), UsageError);
  options.x_direction = Eigen::Vector3d::UnitX();
  options.x_around = LineInSpace{};
  EXPECT_THROW((void)GaugesOf(instant, options), UsageError);
  options.x_direction.reset();
  options.x_around->direction.setZero();
  EXPECT_THROW((void)GaugesOf(instant, options), UsageError);
  SurfaceState bad = instant;
  bad.share_left = Image<float>({3, 3});
  EXPECT_THROW((void)GaugesOf(bad), InputError);
  EXPECT_THROW((void)GaugesOf(instant).Strain(bad, AllOk(kGrid)), InputError);
  EXPECT_THROW((void)GaugesOf(instant).Strain(instant, AllOk({3, 3})), InputError);
  SurfaceState three = instant, one = instant;
  AddModes(three);
  one.along_modes_mm = {three.along_modes_mm[0]};
  EXPECT_THROW((void)GaugesOf(three).Strain(one, AllOk(kGrid)), InputError);
}

}  // namespace
}  // namespace plumbline
