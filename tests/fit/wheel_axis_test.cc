#include "fit/wheel_axis.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

// The motion of the wheel about an axis by an angle, in the rig frame.
Rigid3 TurnBy(const WheelAxis& axis, double angle_rad) {
  return axis.RigFromWheel(angle_rad) * axis.RigFromWheel(0).Inverse();
}

TEST(WheelAxis, PutsTheCameraBelowTheOrigin) {
  const WheelAxis axis = WheelAxis::Through({20, 700, -220}, {0.03, -1, 0.02});
  const Eigen::Vector3d camera = axis.RigFromWheel(0).Inverse() * Eigen::Vector3d::Zero();
  EXPECT_NEAR((camera - Eigen::Vector3d(0, 0, -axis.distance_mm)).norm(), 0, 1e-9);
  EXPECT_NEAR(axis.rotation.determinant(), 1, 1e-12);
  const Eigen::Vector3d through = axis.RigFromWheel(0.7).Inverse() * Eigen::Vector3d(20, 700, -220);
  EXPECT_NEAR(through.x(), 0, 1e-9);
  EXPECT_NEAR(through.z(), 0, 1e-9);
  EXPECT_THROW((void)WheelAxis::Through({0, 5, 0}, {0, 1, 0}), InputError);
}

TEST(WheelAxis, TurnsZTowardsX) {
  Eigen::Matrix3d d;
  const Eigen::Matrix3d R = TurnAboutY(0.5, &d);
  EXPECT_GT((R * Eigen::Vector3d::UnitZ()).x(), 0.4);
  const Eigen::Matrix3d numeric = (TurnAboutY(0.5 + 1e-6) - TurnAboutY(0.5 - 1e-6)) / 2e-6;
  EXPECT_LT((d - numeric).norm(), 1e-9);
}

TEST(AxisOfTurns, FindsTheAxisOfNoisyTurns) {
  const WheelAxis truth = WheelAxis::Through({20, 3, -220}, {0.03, -1, 0.02});
  std::vector<Rigid3> turns;
  for (int i = 1; i < 20; ++i) {
    Rigid3 turn = TurnBy(truth, i == 3 ? -0.03 : 0.02 * i);
    turn.rotation *= RotationFromVector({1e-5 * (i % 3 - 1), 2e-5 * (i % 5 - 2), -1e-5});
    turns.push_back(turn);
  }
  const WheelAxis found = AxisOfTurns(turns);
  EXPECT_LT((found.direction_in_rig() - truth.direction_in_rig()).norm(), 1e-3);
  EXPECT_LT((found.origin_in_rig_mm() - truth.origin_in_rig_mm()).norm(), 0.5);
  EXPECT_NEAR(AngleAbout(found, turns[9]), 0.2, 1e-4);
  EXPECT_NEAR(AngleAbout(found, turns[2]), -0.03, 1e-4);
}

TEST(AxisOfTurns, RefusesAWheelThatStandsStill) {
  EXPECT_THROW((void)AxisOfTurns(std::vector<Rigid3>(5)), InputError);
  EXPECT_THROW((void)AxisOfTurns({}), InputError);
}

TEST(AngleAbout, IsThatOfTheTurnBeyondHalfATurnToo) {
  const WheelAxis axis = WheelAxis::Through({20, 3, -220}, {0.03, -1, 0.02});
  for (const double angle : {-3.1, -1.0, 0.0, 2.0, 3.1}) {
    EXPECT_NEAR(AngleAbout(axis, TurnBy(axis, angle)), angle, 1e-9);
  }
}

}  // namespace
}  // namespace plumbline
