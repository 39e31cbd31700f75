#include "track/wheel_tracks.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "calib/error.h"
#include "tests/track/lifted_wheel.h"

namespace plumbline {
namespace {

using testing::ChainOf;
using testing::LiftedWheel;
using testing::LiftedWheelOptions;

constexpr double kDegree = testing::kDegrees;

WheelAdjustment Adjust(LiftedWheel& wheel, const WheelChain& chain, WheelProblem* problem) {
  WheelTracks tracks(wheel.rig(), chain, LiftedWheelOptions());
  for (int f = 0; f < wheel.frames(); ++f) {
    const WheelFrameMatches m = tracks.Add(f, wheel.Pair(f).left, wheel.Pair(f).right);
    if (std::isfinite(chain.angles_rad[static_cast<std::size_t>(f)])) {
      EXPECT_TRUE(m.placed) << f;
      EXPECT_GT(m.found, 9 * m.looked_for / 10) << f;
    }
  }
  *problem = tracks.Problem();
  return AdjustWheel(wheel.rig(), *problem);
}

TEST(WheelTracks, FollowAnArc) {
  LiftedWheel wheel(9, 4 * kDegree);
  const WheelChain chain = ChainOf(wheel);
  EXPECT_FALSE(chain.closed);
  EXPECT_GE(chain.views.size(), 2U);
  for (int f = 0; f < wheel.frames(); ++f) {
    EXPECT_NEAR(chain.angles_rad[static_cast<std::size_t>(f)], wheel.Angle(f), 0.05 * kDegree) << f;
  }
  WheelProblem problem;
  const WheelAdjustment found = Adjust(wheel, chain, &problem);
  EXPECT_TRUE(found.converged);
  EXPECT_LT(found.sigma0, 1.2);
  EXPECT_LT(found.outliers, 0.02 * static_cast<double>(problem.observations.size()));
  for (int f = 0; f < wheel.frames(); ++f) {
    EXPECT_NEAR(found.angles_rad[static_cast<std::size_t>(f)], wheel.Angle(f), 0.004 * kDegree)
        << f;
  }
  EXPECT_NEAR(found.axis.distance_mm, wheel.Axis().distance_mm, 0.03);
  EXPECT_LT((found.axis.direction_in_rig() - wheel.Axis().direction_in_rig()).norm(),
            0.003 * kDegree);
}

TEST(WheelTracks, CloseAfterAFullTurn) {
  LiftedWheel wheel(41, 9.3 * kDegree);
  const WheelChain chain = ChainOf(wheel, {5});
  EXPECT_TRUE(chain.closed);
  EXPECT_LT(std::abs(chain.misclosure_rad), 0.3 * kDegree);
  EXPECT_TRUE(std::isnan(chain.angles_rad[5]));
  EXPECT_LT(chain.views.back().angle_rad, 2 * std::numbers::pi - 0.03);
  WheelProblem problem;
  const WheelAdjustment found = Adjust(wheel, chain, &problem);
  // Points of the first view are seen by the last frames.
  EXPECT_TRUE(std::any_of(
      problem.observations.begin(), problem.observations.end(), [&](const WheelObservation& o) {
        return o.frame == 40 &&
               o.point < static_cast<int>(chain.views[0].point_in_rig_mm.pixel_count());
      }));
  EXPECT_TRUE(std::isnan(found.angles_rad[5]));
  for (int f = 0; f < wheel.frames(); ++f) {
    if (f == 5) continue;
    EXPECT_NEAR(found.angles_rad[static_cast<std::size_t>(f)], wheel.Angle(f), 0.002 * kDegree)
        << f;
  }
  // All of them together: the sigmas are those of the images' noise.
  Eigen::VectorXd error(wheel.frames());
  Eigen::MatrixXd cov = found.cov_random.bottomRightCorner(wheel.frames(), wheel.frames());
  for (int f = 0; f < wheel.frames(); ++f) {
    error[f] = found.angles_rad[static_cast<std::size_t>(f)] - wheel.Angle(f);
  }
  for (const int f : {0, 5}) {  // held, not placed
    error[f] = 0;
    cov.row(f).setZero();
    cov.col(f).setZero();
    cov(f, f) = 1;
  }
  const double n = wheel.frames() - 2;
  EXPECT_NEAR(error.dot(cov.ldlt().solve(error)) / n, 1, 4 * std::sqrt(2 / n));
}

TEST(WheelChain, RefusesWhatDoesNotTurnOrShowsNothing) {
  LiftedWheel wheel(2, 4 * kDegree);
  WheelChainBuilder still(wheel.rig(), LiftedWheelOptions());
  for (int f = 0; f < 3; ++f) still.Add(wheel.Pair(0).left, wheel.Pair(0).right);
  EXPECT_THROW((void)still.Finish(), InputError);
  WheelChainBuilder blind(wheel.rig(), LiftedWheelOptions());
  const GrayImage wall = testing::Wall(wheel.rig());
  EXPECT_FALSE(blind.Add(wall, wall));
  EXPECT_THROW((void)blind.Finish(), InputError);
}

TEST(WheelChain, RefusesARigThatContradictsTheImages) {
  LiftedWheel wheel(2, 4 * kDegree);
  WheelChainBuilder swapped(wheel.rig(), LiftedWheelOptions());
  EXPECT_THROW(swapped.Add(wheel.Pair(0).right, wheel.Pair(0).left), InputError);
}

TEST(WheelChain, IsTheSameForAnyNumberOfThreads) {
  LiftedWheel wheel(4, 6 * kDegree);
  const auto with = [&](std::size_t threads) {
    for (int f = 0; f < wheel.frames(); ++f) wheel.Pair(f);
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    const WheelChain chain = ChainOf(wheel);
    WheelProblem problem;
    return Adjust(wheel, chain, &problem).angles_rad;
  };
  EXPECT_EQ(with(1), with(2));
}

}  // namespace
}  // namespace plumbline
