#include "track/wheel_adjustment.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <vector>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/track/turning_wheel.h"
#include "track/internal/wheel_equations.h"

namespace plumbline {
namespace {

using testing::kDegree;
using testing::TurningWheel;
using testing::WheelRig;
using testing::WithNoise;
using testing::WithPoorStart;

constexpr Eigen::Index kAxis = WheelAdjustment::kAxis;

// What has to be added to `truth` to get `found`, in the order of WheelAdjustment.
Eigen::VectorXd Error(const WheelProblem& truth, const WheelAdjustment& found) {
  const auto frames = static_cast<Eigen::Index>(truth.angles_rad.size());
  Eigen::VectorXd error(kAxis + frames);
  const Rigid3 turn{truth.axis.rotation.transpose() * found.axis.rotation, Eigen::Vector3d::Zero()};
  error.head<3>() = turn.RotationVector();
  error[3] = found.axis.distance_mm - truth.axis.distance_mm;
  for (Eigen::Index f = 0; f < frames; ++f) {
    error[kAxis + f] = found.angles_rad[static_cast<std::size_t>(f)] -
                       truth.angles_rad[static_cast<std::size_t>(f)];
  }
  return error;
}

TEST(WheelEquations, DerivativesAreThoseOfTheProjection) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 6, 5 * kDegree, 6);
  ASSERT_GT(wheel.observations.size(), 20U);
  internal::WheelEquations equations(rig, wheel);
  const auto residual = [&](std::size_t i, const Eigen::VectorXd& x) {
    WheelAxis axis = wheel.axis;
    axis.rotation *= RotationFromVector(x.head<3>());
    axis.distance_mm += x[3];
    std::vector<double> angles = wheel.angles_rad;
    std::vector<Eigen::Vector3d> points = wheel.points_mm;
    const WheelObservation& o = wheel.observations[i];
    angles[static_cast<std::size_t>(o.frame)] += x[4];
    points[static_cast<std::size_t>(o.point)] += x.tail<3>();
    EXPECT_TRUE(equations.Evaluate(axis, angles, points));
    return Eigen::VectorXd(equations.row(i).residual);
  };
  for (std::size_t i = 0; i < wheel.observations.size(); ++i) {
    const Eigen::MatrixXd numeric = testing::NumericJacobian(
        [&](const Eigen::VectorXd& x) { return residual(i, x); }, Eigen::VectorXd::Zero(8));
    residual(i, Eigen::VectorXd::Zero(8));
    const internal::WheelRow& row = equations.row(i);
    Eigen::Matrix<double, 2, 8> exact;
    exact << row.d_axis, row.d_angle, row.d_point;
    EXPECT_LT((exact - numeric).norm(), 1e-6 * numeric.norm()) << i;
  }
}

TEST(AdjustWheel, FindsAxisAnglesAndPointsFromAPoorStart) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 40, 10 * kDegree, 200);
  const WheelAdjustment found = AdjustWheel(rig, WithPoorStart(wheel));
  EXPECT_TRUE(found.converged);
  EXPECT_LT(Error(wheel, found).norm(), 1e-6);
  EXPECT_EQ(found.outliers, 0);
  for (std::size_t p = 0; p < wheel.points_mm.size(); ++p) {
    EXPECT_LT((found.points_mm[p] - wheel.points_mm[p]).norm(), 1e-5);
  }
}

TEST(AdjustWheel, CovarianceIsThatOfTheNoise) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 38, 10 * kDegree, 150);
  constexpr int kDraws = 250;
  const auto frames = static_cast<Eigen::Index>(wheel.angles_rad.size());
  double nees_axis = 0, nees_angles = 0, nees_point = 0, chi2 = 0;
  int points = 0;
  for (unsigned draw = 0; draw < kDraws; ++draw) {
    const WheelAdjustment found = AdjustWheel(rig, WithNoise(wheel, 100 + draw));
    // Unscaled: the noise is as told.
    const Eigen::MatrixXd cov = found.cov_random / std::max(1.0, found.sigma0 * found.sigma0);
    const Eigen::VectorXd error = Error(wheel, found);
    nees_axis += error.head<4>().dot(cov.topLeftCorner<4, 4>().ldlt().solve(error.head<4>()));
    const Eigen::VectorXd e = error.tail(frames - 1);
    nees_angles += e.dot(cov.bottomRightCorner(frames - 1, frames - 1).ldlt().solve(e));
    chi2 += found.chi2 / found.degrees_of_freedom;
    for (std::size_t p = 0; p < wheel.points_mm.size(); p += 10) {
      const Eigen::Vector3d off = found.points_mm[p] - wheel.points_mm[p];
      nees_point += off.dot(found.cov_points_mm2[p].ldlt().solve(off));
      ++points;
    }
  }
  const auto near = [](double sum, double count, double dimension) {
    EXPECT_NEAR(sum / count / dimension, 1, 4 * std::sqrt(2 / (count * dimension)));
  };
  near(nees_axis, kDraws, 4);
  near(nees_angles, kDraws, static_cast<double>(frames - 1));
  // Points of one draw share axis and angles: fewer are independent.
  EXPECT_NEAR(nees_point / points / 3, 1, 0.05);
  EXPECT_NEAR(chi2 / kDraws, 1, 0.02);
}

TEST(AdjustWheel, AClosedTurnHoldsTheAngles) {
  const StereoRig rig = WheelRig();
  const WheelProblem closed = TurningWheel(rig, 38, 10 * kDegree, 300);
  WheelProblem open = closed;
  // The points seen again after a full turn pass for others.
  const auto first = static_cast<int>(open.points_mm.size());
  open.points_mm.insert(open.points_mm.end(), closed.points_mm.begin(), closed.points_mm.end());
  for (WheelObservation& o : open.observations) {
    if (o.frame > 28) {
      const double at = std::atan2(open.points_mm[static_cast<std::size_t>(o.point)].x(),
                                   -open.points_mm[static_cast<std::size_t>(o.point)].z());
      if (std::abs(at) < 0.9) o.point += first;
    }
  }
  const WheelAdjustment a = AdjustWheel(rig, closed), b = AdjustWheel(rig, open);
  const auto sigma = [](const WheelAdjustment& found, Eigen::Index frame) {
    return std::sqrt(found.cov_random(kAxis + frame, kAxis + frame));
  };
  EXPECT_LT(sigma(a, 36), 0.5 * sigma(b, 36));
  EXPECT_LT(sigma(a, 18), 0.8 * sigma(b, 18));
  // What the calibration does to the angles cancels over a full turn.
  const auto calibration = [](const WheelAdjustment& found, Eigen::Index frame) {
    return found.along_modes.col(kAxis + frame).norm();
  };
  EXPECT_LT(calibration(a, 36), 0.1 * calibration(b, 36));
}

TEST(AdjustWheel, OutliersDoNotMatter) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 38, 10 * kDegree, 200);
  WheelProblem noisy = WithNoise(wheel, 5);
  int wrong = 0;
  for (std::size_t i = 0; i < noisy.observations.size(); i += 17) {
    noisy.observations[i].pixel +=
        Eigen::Vector2d(i % 2 == 0 ? 3 : -0.6, 1 + 0.1 * static_cast<double>(i % 13));
    ++wrong;
  }
  const WheelAdjustment found = AdjustWheel(rig, WithPoorStart(noisy));
  EXPECT_TRUE(found.converged);
  EXPECT_NEAR(found.sigma0, 1, 0.06);
  EXPECT_NEAR(found.outliers, wrong, 5);
  const Eigen::VectorXd error = Error(wheel, found);
  for (Eigen::Index k = 0; k < error.size(); ++k) {
    EXPECT_LE(std::abs(error[k]), 4.5 * std::sqrt(found.cov_random(k, k))) << k;
  }
}

TEST(AdjustWheel, CalibrationModesDoWhatSolvingAgainDoes) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 38, 10 * kDegree, 120);
  const WheelAdjustment found = AdjustWheel(rig, wheel);
  ASSERT_EQ(found.along_modes.rows(), rig.modes.count());
  for (int k = 0; k < rig.modes.count(); ++k) {
    WheelAdjustmentOptions all;
    all.outlier_sigmas = 100;
    all.loss_scale_sigmas = 1000;
    const WheelAdjustment again = AdjustWheel(rig.AlongMode(k), wheel, all);
    const Eigen::VectorXd change = Error(wheel, again);
    const Eigen::VectorXd expected = found.along_modes.row(k).transpose();
    EXPECT_LT((change.head<3>() - expected.head<3>()).norm(), 0.01 * change.head<3>().norm() + 1e-8)
        << k;
    EXPECT_NEAR(change[3], expected[3], 0.01 * std::abs(change[3]) + 1e-6) << k;
    EXPECT_LT((change - expected).tail(38).norm(), 0.05 * change.tail(38).norm() + 1e-6) << k;
    for (std::size_t p = 0; p < wheel.points_mm.size(); p += 11) {
      const Eigen::Vector3d moved = again.points_mm[p] - wheel.points_mm[p];
      EXPECT_LT((moved - found.points_along_modes_mm[p].col(k)).norm(), 0.02 * moved.norm() + 1e-3);
    }
  }
}

TEST(AdjustWheel, FramesThatSeeNothingAreMarked) {
  const StereoRig rig = WheelRig();
  WheelProblem wheel = WithNoise(TurningWheel(rig, 12, 5 * kDegree, 80), 1);
  std::erase_if(wheel.observations, [](const WheelObservation& o) { return o.frame == 4; });
  const WheelAdjustment found = AdjustWheel(rig, wheel);
  EXPECT_TRUE(std::isnan(found.angles_rad[4]));
  EXPECT_TRUE(std::isnan(found.cov_random(kAxis + 4, kAxis + 4)));
  EXPECT_TRUE(std::isfinite(found.angles_rad[5]));
  EXPECT_NEAR(found.angles_rad[5], wheel.angles_rad[5], 1e-4);
}

TEST(AdjustWheel, RefusesAWheelThatStandsStill) {
  const StereoRig rig = WheelRig();
  EXPECT_THROW((void)AdjustWheel(rig, TurningWheel(rig, 10, 0, 50)), InputError);
  WheelProblem behind = TurningWheel(rig, 10, 5 * kDegree, 50);
  behind.points_mm[static_cast<std::size_t>(behind.observations[0].point)] *= -1;
  EXPECT_THROW((void)AdjustWheel(rig, behind), InputError);
  WheelProblem wrong = TurningWheel(rig, 10, 5 * kDegree, 50);
  wrong.observations[3].frame = 10;
  EXPECT_THROW((void)AdjustWheel(rig, wrong), std::invalid_argument);
}

TEST(AdjustWheel, IsTheSameForAnyNumberOfThreads) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = WithNoise(TurningWheel(rig, 38, 10 * kDegree, 150), 9);
  const auto with = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return AdjustWheel(rig, wheel);
  };
  const WheelAdjustment one = with(1), two = with(2);
  EXPECT_EQ(one.angles_rad, two.angles_rad);
  EXPECT_EQ(one.cov_random, two.cov_random);
}

}  // namespace
}  // namespace plumbline
