#include "io/virtual_rig/lighting.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {
namespace {

Camera Pinhole() {
  Eigen::VectorXd p = Eigen::VectorXd::Zero(9);
  p.head<4>() << 350, 350, 319.5, 239.5;
  return Camera(LensModel{}, {640, 480}, p);
}

// One diode at the camera, nothing else.
LightingOptions OneDiode() {
  LightingOptions options;
  options.leds_in_rig_mm = {{0, 0, 0}};
  options.ambient = 0;
  options.reference_distance_mm = 100;
  options.vignetting = 0;
  return options;
}

const Eigen::Vector2d kMiddle(319.5, 239.5);
const Eigen::Vector3d kFacing(0, 0, -1);

TEST(Lighting, FallsWithTheSquareOfTheDistanceAndTheCosineOfTheSlope) {
  const Light light = MakeLight(OneDiode(), Pinhole(), Rigid3(), 1);
  EXPECT_NEAR(light({0, 0, 100}, kFacing, kMiddle), 1, 1e-12);
  EXPECT_NEAR(light({0, 0, 200}, kFacing, kMiddle), 0.25, 1e-12);
  EXPECT_NEAR(light({0, 0, 50}, kFacing, kMiddle), 4, 1e-12);
  const Eigen::Vector3d tilted(std::sin(0.7), 0, -std::cos(0.7));
  EXPECT_NEAR(light({0, 0, 100}, tilted, kMiddle), std::cos(0.7), 1e-12);
  // Beside the axis both: cos^3 of the angle at a plane.
  EXPECT_NEAR(light({100, 0, 100}, kFacing, kMiddle), std::pow(0.5, 1.5), 1e-12);
}

TEST(Lighting, DiodesShareTheLightAndMoveWithTheRig) {
  LightingOptions options = OneDiode();
  options.leds_in_rig_mm = {{-30, 0, 0}, {70, 0, 0}};
  const Rigid3 ground_from_rig = Rigid3::FromRotationVector({0.2, 0.1, 0.4}, {10, -20, 30});
  const Light light = MakeLight(options, Pinhole(), ground_from_rig, 1);
  const Eigen::Vector3d at(0, 0, 100);
  const double expected =
      (std::pow(1 + 0.09, -1.5) + std::pow(1 + 0.49, -1.5)) / 2;  // distance and slope
  EXPECT_NEAR(light(ground_from_rig * at, ground_from_rig.rotation * kFacing, kMiddle), expected,
              1e-12);
}

TEST(Lighting, VignettingGrowsWithTheSquareOfTheRadiusToTheCorner) {
  LightingOptions options = OneDiode();
  options.ambient = 1;
  options.vignetting = 0.3;
  const Light light = MakeLight(options, Pinhole(), Rigid3(), 1);
  const Eigen::Vector3d anywhere(12, 34, 156);
  EXPECT_NEAR(light(anywhere, kFacing, kMiddle), 1, 1e-12);
  EXPECT_NEAR(light(anywhere, kFacing, {0, 0}), 0.7, 1e-12);
  EXPECT_NEAR(light(anywhere, kFacing, {639, 479}), 0.7, 1e-12);
  EXPECT_NEAR(light(anywhere, kFacing, kMiddle / 2), 1 - 0.3 / 4, 1e-12);
}

TEST(Lighting, AmbientLightAndBrightnessAreSharesOfTheWhole) {
  LightingOptions options = OneDiode();
  options.ambient = 0.4;
  const Light light = MakeLight(options, Pinhole(), Rigid3(), 1.1);
  EXPECT_NEAR(light({0, 0, 200}, kFacing, kMiddle), 1.1 * (0.4 + 0.6 * 0.25), 1e-12);
}

// In the picture of an evenly white sheet: brightest under the diodes, darkest in the corners, and
// at the corners by the vignetting on top.
TEST(Lighting, VariesOverThePictureAsStated) {
  Scenario scenario = MakeScenario("still", RigKind::kWide640);
  scenario.speckle.black = scenario.speckle.white;
  scenario.lighting.flicker = 0;
  std::get<SpecimenOptions>(scenario.surface).size_mm = {600, 500};
  const Image<float> dim = VirtualRig(scenario).MeanImage(0, Side::kLeft);
  scenario.lighting.vignetting = 0;
  const Image<float> even = VirtualRig(scenario).MeanImage(0, Side::kLeft);
  EXPECT_GT(even(240, 320), 1.5F * even(5, 5));
  for (const auto& [x, y] : {std::pair(320, 240), std::pair(40, 240), std::pair(600, 30)}) {
    const double radius2 = (Eigen::Vector2d(x, y) - kMiddle).squaredNorm() / kMiddle.squaredNorm();
    EXPECT_NEAR(dim(y, x) / even(y, x), 1 - 0.25 * radius2, 1e-4) << x << " " << y;
  }
}

TEST(Lighting, RefusesWhatItCannotBe) {
  const auto refused = [](auto change) {
    LightingOptions options;
    change(options);
    EXPECT_THROW(options.Check(), UsageError);
  };
  refused([](LightingOptions& o) { o.ambient = 1.1; });
  refused([](LightingOptions& o) { o.leds_in_rig_mm.clear(); });
  refused([](LightingOptions& o) { o.reference_distance_mm = 0; });
  refused([](LightingOptions& o) { o.vignetting = 1; });
  refused([](LightingOptions& o) { o.flicker = -0.1; });
}

}  // namespace
}  // namespace plumbline
