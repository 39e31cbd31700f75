#include "io/virtual_rig/render.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>
#include <utility>

#include "calib/error.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {
namespace {

double MeanDifference(const Image<float>& a, const Image<float>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.pixel_count(); ++i) {
    sum += std::abs(static_cast<double>(a.data()[i]) - static_cast<double>(b.data()[i]));
  }
  return sum / static_cast<double>(a.pixel_count());
}

// The scenario seen on a strip through the middle of the left camera's sensor, of all its width.
Scenario OnAStrip(Scenario scenario, int height) {
  const Camera& camera = scenario.rig.left;
  Eigen::VectorXd p = camera.parameters();
  p[3] -= (camera.size().height - height) / 2;
  scenario.rig.left = Camera(camera.model(), {camera.size().width, height}, std::move(p));
  return scenario;
}

Image<float> MeanImage(Scenario scenario, int frame, int samples_per_px) {
  scenario.render.samples_per_px = samples_per_px;
  return VirtualRig(std::move(scenario)).MeanImage(frame, Side::kLeft);
}

TEST(Render, HalvingTheSampleSpacingChangesLessThanATenthOfAGreyLevel) {
  struct Case {
    const char* name;
    RigKind rig;
  };
  for (const auto& [name, rig] :
       {Case{"tyre-flat", RigKind::kWide640}, Case{"tyre-flat", RigKind::kWide1280},
        Case{"cleat-lateral-square38", RigKind::kWide640}, Case{"nuts", RigKind::kWide640},
        Case{"incline", RigKind::kWide640}, Case{"shear", RigKind::kLaboratory}}) {
    const Scenario scenario = OnAStrip(MakeScenario(name, rig), 240);
    const int samples = scenario.render.samples_per_px;
    const Image<float> normal = MeanImage(scenario, 4, samples);
    const double change = MeanDifference(normal, MeanImage(scenario, 4, 2 * samples));
    std::printf("%s %dx%d: %.4f grey levels\n", name, normal.width(), normal.height(), change);
    EXPECT_LT(change, 0.1) << name;
    EXPECT_GT(change, 0) << name;
  }
}

TEST(Render, ConvergesAsSamplesGrow) {
  const Scenario scenario = OnAStrip(MakeScenario("tyre-flat"), 120);
  const Image<float> fine = MeanImage(scenario, 0, 16);
  const double at2 = MeanDifference(MeanImage(scenario, 0, 2), fine);
  const double at4 = MeanDifference(MeanImage(scenario, 0, 4), fine);
  const double at8 = MeanDifference(MeanImage(scenario, 0, 8), fine);
  EXPECT_LT(at4, 0.6 * at2);
  EXPECT_LT(at8, 0.6 * at4);
}

TEST(Render, GivesTheSamePixelsForAnyNumberOfThreads) {
  Scenario scenario = MakeScenario("cleat-lateral-square38");
  scenario.frames = 1;
  const VirtualRig rig(scenario);
  const GrayImage all = rig.TakeImage(0, Side::kRight);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_EQ(rig.TakeImage(0, Side::kRight).grey.values(), all.grey.values());
}

// A bright half plane: the edge's profile is the pixel's box convolved with the lens's blur.
TEST(Render, PixelsAreBoxesBlurredByThePointSpread) {
  class Edge : public Albedo {
   public:
    void Evaluate(std::span<const Eigen::Vector2d> m, std::span<float> out) const override {
      for (std::size_t i = 0; i < m.size(); ++i) out[i] = m[i].x() < 0 ? 0.f : 1.f;
    }
  };
  const auto sheet = MakeSpecimen({});
  const auto now = sheet->At(0);
  Eigen::VectorXd p = Eigen::VectorXd::Zero(9);
  p.head<4>() << 1000, 1000, 49.8, 50;
  const Camera camera(LensModel{}, {101, 101}, p);
  Rigid3 ground_from_camera;
  ground_from_camera.rotation.diagonal() << 1, -1, -1;
  ground_from_camera.translation_mm.z() = 500;
  const Exposure exposure{now.get(), now.get(), ground_from_camera.Inverse(),
                          ground_from_camera.Inverse()};
  RenderOptions options;
  options.samples_per_px = 16;
  options.psf_sigma_px = 0.6;
  options.full_scale_grey = 1;
  const Image<float> image = Render(
      camera, exposure, Edge(), [](const auto&, const auto&, const auto&) { return 1.0; }, options);
  for (int x = 44; x < 56; ++x) {
    // Integral of the normal distribution function over the pixel.
    const auto integral = [&](double d) {
      const double z = d / 0.6;
      return 0.6 * (z * 0.5 * std::erfc(-z / std::sqrt(2)) +
                    std::exp(-z * z / 2) / std::sqrt(2 * std::numbers::pi));
    };
    const double expected = integral(x + 0.5 - 49.8) - integral(x - 0.5 - 49.8);
    EXPECT_NEAR(image(50, x), expected, 0.012) << x;
  }
}

// What the shutter sees is the mean over its exposure.
TEST(Render, MotionBlurIsTheMeanOverTheExposure) {
  Scenario scenario = OnAStrip(MakeScenario("shift", RigKind::kWide640), 120);
  scenario.lighting.flicker = 0;
  scenario.frames = 3;
  scenario.exposure_s = 0.01;
  // 2 px in the exposure.
  const double speed_mm_s = 2 * 160.0 / 350 / scenario.exposure_s;
  auto& specimen = std::get<SpecimenOptions>(scenario.surface);
  specimen.end_time_s = 1;
  specimen.size_mm = {300, 240};
  specimen.translation_mm = {0.8 * speed_mm_s, 0.6 * speed_mm_s, 0};
  const double middle_s = 1 / scenario.frames_per_second;
  const Image<float> blurred = VirtualRig(scenario).MeanImage(1, Side::kLeft);
  Image<float> mean(blurred.size());
  constexpr int kMoments = 12;
  Scenario sharp = scenario;
  sharp.exposure_s = 0;
  for (int k = 0; k < kMoments; ++k) {
    // The same place as at this moment of the exposure.
    const double moment_s = middle_s + scenario.exposure_s * ((k + 0.5) / kMoments - 0.5);
    std::get<SpecimenOptions>(sharp.surface).translation_mm =
        specimen.translation_mm * moment_s / middle_s;
    const Image<float> image = VirtualRig(sharp).MeanImage(1, Side::kLeft);
    for (std::size_t i = 0; i < mean.pixel_count(); ++i) {
      mean.data()[i] += image.data()[i] / kMoments;
    }
  }
  EXPECT_LT(MeanDifference(blurred, mean), 0.3);
  std::get<SpecimenOptions>(sharp.surface).translation_mm = specimen.translation_mm;
  EXPECT_GT(MeanDifference(VirtualRig(sharp).MeanImage(1, Side::kLeft), mean), 2);
}

TEST(Render, RefusesWhatItCannotDo) {
  RenderOptions options;
  options.samples_per_px = 0;
  EXPECT_THROW(options.Check(), UsageError);
  options = {};
  options.psf_sigma_px = -1;
  EXPECT_THROW(options.Check(), UsageError);
}

}  // namespace
}  // namespace plumbline
