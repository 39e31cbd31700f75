#include "fit/deformation_symmetry.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "tests/support/tyre_frames.h"

namespace plumbline {
namespace {

using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

constexpr double kDegree = std::numbers::pi / 180;

double TruePitch(const TyreFrame& frame) {
  const Eigen::Vector3d normal = frame.axis.rotation.transpose() * frame.Ground().normal;
  return std::atan2(normal.x(), normal.z());
}

TyreFrame Noisy(const Scenario& scenario, int frame, double sigma_mm = 0.05) {
  std::mt19937 random(1);
  return WithNoise(TrueTyreFrame(VirtualRig(scenario), frame, 10), sigma_mm, 3, random);
}

TEST(DeformationSymmetry, TellsThePitchOverABarAlongTheWay) {
  for (const char* name : {"cleat-longitudinal-square38", "cleat-longitudinal-angle40",
                           "cleat-offset-square50", "tyre-flat", "tyre-braking"}) {
    for (const double pitch_deg : {-3.0, 3.0}) {
      const TyreFrame frame = Noisy(TyreScenario(name, {0.8, -1.5 + pitch_deg, 0.4}), 0);
      std::string why;
      const auto found =
          FindSymmetry(frame.point_mm, 0.05, frame.axis, 0, {.correlation_area_points = 9}, &why);
      ASSERT_TRUE(found.has_value()) << name << ": " << why;
      const double error_rad = found->pitch_rad - TruePitch(frame);
      EXPECT_LT(std::abs(error_rad), 0.1 * kDegree) << name;
      EXPECT_LT(std::abs(error_rad),
                2 * std::hypot(found->sigma_noise_rad, found->sigma_asymmetry_rad))
          << name;
      EXPECT_LT(found->sigma_noise_rad, 0.02 * kDegree) << name;
    }
  }
}

TEST(DeformationSymmetry, SigmaOfNoiseIsThatOfSampling) {
  const VirtualRig rig(TyreScenario("cleat-longitudinal-square38", {0.8, -1.5, 0.4}));
  const TyreFrame truth = TrueTyreFrame(rig, 0, 16);
  std::mt19937 random(2);
  constexpr int kDraws = 60;
  double sum = 0, square = 0, claimed = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const TyreFrame frame = WithNoise(truth, 0.07, 1, random);
    const auto found = FindSymmetry(frame.point_mm, 0.07, frame.axis, 0);
    ASSERT_TRUE(found.has_value());
    sum += found->pitch_rad / kDraws;
    square += found->pitch_rad * found->pitch_rad / kDraws;
    claimed += found->sigma_noise_rad / kDraws;
  }
  EXPECT_NEAR(claimed / std::sqrt((square - sum * sum) * kDraws / (kDraws - 1)), 1, 0.3);
}

TEST(DeformationSymmetry, IsNotThatOfAnObstacle) {
  // The bar stands under the axis within some millimetres: all is symmetric, but about the bar.
  for (const double way_mm : {-6.0, -2.0, 3.0}) {
    Scenario scenario = TyreScenario("cleat-lateral-square38", {0.8, -1.5, 0.4});
    std::get<TyreOptions>(scenario.surface).start_travel_mm = way_mm;
    const TyreFrame frame = Noisy(scenario, 0);
    std::string why;
    EXPECT_FALSE(FindSymmetry(frame.point_mm, 0.05, frame.axis, 0, {}, &why).has_value());
    EXPECT_NE(why.find("obstacle"), std::string::npos) << why;
  }
  for (const char* name : {"cleat-diagonal-square50", "nuts", "tyre-disturbed"}) {
    for (const int f : {1, 4, 7}) {
      const TyreFrame frame = Noisy(TyreScenario(name, {0.8, -1.5, 0.4}), f);
      EXPECT_FALSE(FindSymmetry(frame.point_mm, 0.05, frame.axis, 0).has_value()) << name << f;
    }
  }
}

TEST(DeformationSymmetry, IsNotThereWithoutDeformation) {
  const TyreFrame frame = Noisy(TyreScenario("tyre-lifted", {0.8, -1.5, 0.4}), 0);
  std::string why;
  EXPECT_FALSE(FindSymmetry(frame.point_mm, 0.05, frame.axis, 0, {}, &why).has_value());
  EXPECT_FALSE(why.empty());
  EXPECT_FALSE(
      FindSymmetry(Image<Eigen::Vector3d>({3, 3}, Eigen::Vector3d::Zero()), 0.05, frame.axis, 0)
          .has_value());
  EXPECT_THROW((void)FindSymmetry(frame.point_mm, 0.05, frame.axis, 0, {.max_sigma_rad = 0}),
               UsageError);
}

}  // namespace
}  // namespace plumbline
