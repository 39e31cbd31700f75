#include "track/camera_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>
#include <stdexcept>
#include <vector>

#include "tests/support/rendered_surface.h"
#include "tests/support/seen_matches.h"

namespace plumbline {
namespace {

constexpr double kNoise_px = 0.02;

StereoRig Rig() { return testing::ConvergentRig({640, 512}, 1500, 400, 140); }

StereoRig Turned(StereoRig rig, const Eigen::Vector3d& turn_rad) {
  rig.right_from_left =
      Rigid3::FromRotationVector(turn_rad, Eigen::Vector3d::Zero()) * rig.right_from_left;
  return rig;
}

std::vector<StereoObservation> See(const StereoRig& rig, std::uint32_t seed) {
  return testing::SeeCurvedSurface(rig, kNoise_px, kNoise_px, seed);
}

TEST(CameraMotion, IsFoundWithErrorsThatCoverIt) {
  const StereoRig rig = Rig();
  const Eigen::Vector3d turn(2e-4, 0, -4e-4);
  double nees = 0;
  constexpr int kDraws = 60;
  for (std::uint32_t draw = 0; draw < kDraws; ++draw) {
    const RelativePose first = PoseOfPair(rig, See(rig, 2 * draw));
    const CameraMotion motion = MotionSince(rig, first, See(Turned(rig, turn), 2 * draw + 1));
    EXPECT_TRUE(motion.moved);
    // Told along each of the independent directions of its errors.
    const auto errors = ErrorsOfMotion(motion.since.cov_random, rig.baseline_mm());
    ASSERT_EQ(errors.size(), 5U);
    Eigen::Matrix<double, 6, 5> J;
    for (int k = 0; k < 5; ++k) J.col(k) = errors[static_cast<std::size_t>(k)];
    Eigen::Matrix<double, 6, 1> off = motion.since.change;
    off.head<3>() -= turn;
    nees += (J.completeOrthogonalDecomposition().solve(off)).squaredNorm() / kDraws;
    EXPECT_LT((J * J.transpose() - motion.since.cov_random).norm(),
              1e-6 * motion.since.cov_random.norm());
    for (int k = 1; k < 5; ++k) {
      EXPECT_LE(J.col(k).head<3>().norm() * rig.baseline_mm(), J.col(0).norm() * rig.baseline_mm());
    }
  }
  EXPECT_NEAR(nees, 5, 1.3);
}

// Right pixels that are all off together by a pattern that looks like a motion in part.
TEST(CameraMotion, CountsAnErrorThatAllMatchesHaveInCommon) {
  const StereoRig rig = Rig();
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  double nees = 0, nees_without = 0;
  constexpr int kDraws = 60;
  for (std::uint32_t draw = 0; draw < kDraws; ++draw) {
    const RelativePose first = PoseOfPair(rig, See(rig, 2 * draw));
    std::vector<StereoObservation> later = See(rig, 2 * draw + 1);
    std::vector<Eigen::Vector2d> pattern;
    const double size = normal(random);
    for (StereoObservation& o : later) {
      pattern.emplace_back(0, 0.02 * std::sin(o.right.x() / 150));
      o.right += size * pattern.back();
    }
    nees += MotionSince(rig, first, later, 1, {}, pattern).since.chi2 / 5 / kDraws;
    nees_without += MotionSince(rig, first, later).since.chi2 / 5 / kDraws;
  }
  EXPECT_NEAR(nees, 1, 0.3);
  EXPECT_GT(nees_without, 3);
  EXPECT_THROW((void)MotionSince(rig, PoseOfPair(rig, See(rig, 1)), See(rig, 2), 1, {},
                                 std::vector<Eigen::Vector2d>(3)),
               std::invalid_argument);
}

TEST(CameraMotion, IsNoneWhereThereIsNoneOrTheLensesAloneAreWrong) {
  const StereoRig rig = Rig();
  const RelativePose first = PoseOfPair(rig, See(rig, 1));
  EXPECT_FALSE(MotionSince(rig, first, See(rig, 2)).moved);
  CameraMotionLimits limits;
  EXPECT_FALSE(limits.Beyond(1e6, 0.100, 0.0995));
  EXPECT_FALSE(limits.Beyond(39, 1, 0));
  EXPECT_TRUE(limits.Beyond(41, 0.025, 0.019));
}

TEST(CameraMotion, MovesThePoseAndKeepsTheBaselinesLength) {
  const StereoRig rig = Rig();
  Eigen::Matrix<double, 6, 1> motion;
  motion << 0, 0, 0.1, 1, 2, 3;
  const Rigid3 moved = PoseAfter(motion, rig.right_from_left);
  const Eigen::Vector3d point(10, 20, 400);
  EXPECT_LT((moved * point -
             Rigid3::FromRotationVector({0, 0, 0.1}, {1, 2, 3}) * (rig.right_from_left * point))
                .norm(),
            1e-9);
  EXPECT_NEAR(WithBaselineOf(rig, moved).translation_mm.norm(), rig.baseline_mm(), 1e-9);
  EXPECT_LT(WithBaselineOf(rig, moved).translation_mm.cross(moved.translation_mm).norm(), 1e-9);
}

}  // namespace
}  // namespace plumbline
