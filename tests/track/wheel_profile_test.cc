#include "track/wheel_profile.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/track/turning_wheel.h"

namespace plumbline {
namespace {

using testing::kDegree;
using testing::TurningWheel;
using testing::WheelRig;
using testing::WithNoise;

// r = 384 - y^2 / 600 (TurningWheel).
double TrueRadius(double y) { return 384 - y * y / 600; }

TEST(WheelProfile, IsTheMeridianThatThePointsLieOn) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 38, 10 * kDegree, 600);
  const WheelProfile profile = ProfileOf(AdjustWheel(rig, wheel));
  ASSERT_GT(profile.y_mm.size(), 20U);
  for (std::size_t i = 0; i < profile.y_mm.size(); ++i) {
    // The mean of a parabola over a bin of 5 mm.
    EXPECT_NEAR(profile.radius_mm[i], TrueRadius(profile.y_mm[i]) - 25.0 / 12 / 600, 0.004);
    EXPECT_LT(profile.scatter_mm[i], 0.01);
    EXPECT_GE(profile.points[i], WheelProfile::kFewest);
  }
  EXPECT_NEAR(profile.crown_radius_mm, 384, 1e-4);
  EXPECT_NEAR(profile.crown_y_mm, 0, 1e-2);
}

TEST(WheelProfile, SigmasAreThoseOfTheNoiseAndOfTheCalibration) {
  const StereoRig rig = WheelRig();
  const WheelProblem wheel = TurningWheel(rig, 38, 10 * kDegree, 250, 0.1);
  const WheelProfile truth = ProfileOf(AdjustWheel(rig, wheel));
  constexpr int kDraws = 150;
  double crown = 0, bin = 0;
  const std::size_t middle = truth.y_mm.size() / 2;
  for (unsigned draw = 0; draw < kDraws; ++draw) {
    const WheelAdjustment found = AdjustWheel(rig, WithNoise(wheel, 50 + draw));
    const WheelProfile profile = ProfileOf(found);
    const double scale = std::max(1.0, found.sigma0);
    const auto square = [&](double off, double sigma) { return std::pow(off * scale / sigma, 2); };
    crown += square(profile.crown_radius_mm - 384, profile.sigma_crown_random_mm);
    // Points next to the edge of a bin come and go with the noise; their mean hardly does.
    bin += square(profile.radius_mm[middle] - TrueRadius(profile.y_mm[middle]) -
                      (truth.radius_mm[middle] - TrueRadius(truth.y_mm[middle])),
                  profile.sigma_random_mm[middle]);
  }
  EXPECT_NEAR(crown / kDraws, 1, 4 * std::sqrt(2.0 / kDraws));
  EXPECT_NEAR(bin / kDraws, 1, 5 * std::sqrt(2.0 / kDraws));
  double calibration = 0;
  for (int k = 0; k < rig.modes.count(); ++k) {
    const WheelProfile moved = ProfileOf(AdjustWheel(rig.AlongMode(k), wheel));
    calibration += std::pow(moved.crown_radius_mm - truth.crown_radius_mm, 2);
  }
  EXPECT_NEAR(truth.sigma_crown_calibration_mm, std::sqrt(calibration),
              0.05 * std::sqrt(calibration));
}

}  // namespace
}  // namespace plumbline
