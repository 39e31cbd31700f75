// The virtual rig through every lens model that calib knows.

#include <gtest/gtest.h>

#include <cmath>

#include "tests/io/virtual_rig/mrcal_check.h"

namespace plumbline {
namespace {

Camera MakeCamera(const std::string& model_name, double skew) {
  const LensModel model = LensModel::FromName(model_name);
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  p.head<4>() << 352 + skew, 350, 321 - skew, 238;
  if (model.IsSplined()) {
    // Waves of up to two pixels over the image.
    for (Eigen::Index k = 4; k < p.size(); ++k) {
      p[k] = 0.003 * std::sin(0.37 * static_cast<double>(k) + skew);
    }
  } else {
    const double terms[] = {-0.2, 0.05, 4e-4, -3e-4, -0.002, 0.01, -0.004, 0.001};
    for (Eigen::Index k = 4; k < p.size(); ++k) p[k] = terms[k - 4];
  }
  return Camera(model, {640, 480}, p);
}

class LensModels : public ::testing::TestWithParam<const char*> {
 protected:
  LensModels()
      : rig{MakeCamera(GetParam(), 0),
            MakeCamera(GetParam(), 1.5),
            Rigid3::FromRotationVector({0.004, -0.006, 0.003}, {-40, 0.3, -0.5}),
            {},
            ""} {}

  StereoRig rig;
};

TEST_P(LensModels, TruePixelsAreMrcalsProjections) {
  testing::ExpectMrcalProjectsTheTruth(VirtualRig(MakeScenario("tyre-flat", rig, 160)), 2);
}

// Without blur, light or noise a pixel of one sample is the albedo of the material under it.
TEST_P(LensModels, PicturesShowTheMaterialUnderEachPixel) {
  Scenario scenario = MakeScenario("tyre-flat", rig, 160);
  scenario.exposure_s = 0;
  scenario.lighting = {.ambient = 1, .vignetting = 0, .flicker = 0};
  scenario.render.samples_per_px = 1;
  scenario.render.psf_sigma_px = 0;
  const VirtualRig virtual_rig(scenario);
  const auto truth = virtual_rig.Truth(0);
  const auto speckle = MakeSpeckle(virtual_rig.surface().Domain(), scenario.speckle);
  const Image<float> image = virtual_rig.MeanImage(0, Side::kLeft);
  int count = 0;
  for (int y = 3; y < 480; y += 7) {
    for (int x = 1; x < 640; x += 9) {
      const auto point = truth->UnderLeftPixel(Eigen::Vector2d(x, y));
      if (!point) continue;
      ++count;
      float albedo = 0;
      speckle->Evaluate({&point->material_mm, 1}, {&albedo, 1});
      EXPECT_NEAR(image(y, x), scenario.render.full_scale_grey * albedo, 0.1) << x << " " << y;
    }
  }
  EXPECT_GT(count, 4500);
}

INSTANTIATE_TEST_SUITE_P(All, LensModels,
                         ::testing::Values("OPENCV4", "OPENCV5", "OPENCV8",
                                           "SPLINED_STEREOGRAPHIC_order=2_Nx=12_Ny=9_fov_x_deg=100",
                                           "SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=12_fov_x_deg="
                                           "100"));

}  // namespace
}  // namespace plumbline
