#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>

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

// One stereo frame of a tyre scenario at default quality, noise and all.
void RenderTyreFrame(benchmark::State& state, const char* name, RigKind kind) {
  const oneapi::tbb::global_control threads(oneapi::tbb::global_control::max_allowed_parallelism,
                                            static_cast<std::size_t>(state.range(0)));
  const VirtualRig rig(MakeScenario(name, kind));
  Scenario fine = rig.scenario();
  fine.render.samples_per_px *= 2;
  const double change =
      MeanDifference(rig.MeanImage(4, Side::kLeft), VirtualRig(fine).MeanImage(4, Side::kLeft));
  if (!(change < 0.1)) state.SkipWithError("the image has not converged");
  for (auto _ : state) {
    benchmark::DoNotOptimize(rig.TakeImage(4, Side::kLeft));
    benchmark::DoNotOptimize(rig.TakeImage(4, Side::kRight));
  }
  state.SetItemsProcessed(state.iterations());  // stereo frames
  state.counters["grey_change_at_twice_the_samples"] = change;
}
BENCHMARK_CAPTURE(RenderTyreFrame, flat_640x480, "tyre-flat", RigKind::kWide640)
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(RenderTyreFrame, bar_640x480, "cleat-lateral-square38", RigKind::kWide640)
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(RenderTyreFrame, flat_1280x1024, "tyre-flat", RigKind::kWide1280)
    ->ArgName("threads")
    ->Arg(2)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

// The baseline: the same picture by an exact look at every sample, without interpolation between
// exact nodes. Its answer is the same to a few thousandths of a grey level.
void RenderEverySampleExactly(benchmark::State& state) {
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  Scenario scenario = MakeScenario("tyre-flat");
  scenario.exposure_s = 0;
  scenario.render.psf_sigma_px = 0;
  scenario.lighting.flicker = 0;
  scenario.lighting.ambient = 1;
  scenario.lighting.vignetting = 0;
  const VirtualRig rig(scenario);
  const auto now = rig.surface().At(rig.FrameTime(4));
  const SurfaceView view(scenario.rig.left, rig.GroundFromRig(rig.FrameTime(4)).Inverse(), *now);
  const auto speckle = MakeSpeckle(rig.surface().Domain(), scenario.speckle);
  const int S = scenario.render.samples_per_px;
  constexpr int kRows = 48;
  Image<float> exact({640, kRows});
  for (auto _ : state) {
    for (int y = 0; y < kRows; ++y) {
      for (int x = 0; x < 640; ++x) {
        float sum = 0;
        for (int k = 0; k < S * S; ++k) {
          const Eigen::Vector2d at(x - 0.5 + (k % S + 0.5) / S, 200 + y - 0.5 + (k / S + 0.5) / S);
          const auto seen = view.Look(at);
          float albedo = 0;
          if (seen) speckle->Evaluate({&seen->material_mm, 1}, {&albedo, 1});
          sum += albedo;
        }
        exact(y, x) =
            sum / static_cast<float>(S * S) * static_cast<float>(scenario.render.full_scale_grey);
      }
    }
  }
  const Image<float> ours = rig.MeanImage(4, Side::kLeft);
  double difference = 0;
  for (int y = 0; y < kRows; ++y) {
    for (int x = 0; x < 640; ++x) {
      difference = std::max(difference, std::abs(static_cast<double>(exact(y, x)) -
                                                 static_cast<double>(ours(200 + y, x))));
    }
  }
  if (!(difference < 0.05)) state.SkipWithError("the two renderings differ");
  // In stereo frames of 640x480.
  state.SetItemsProcessed(state.iterations());
  state.counters["stereo_frames"] = benchmark::Counter(
      static_cast<double>(state.iterations()) * kRows / 480 / 2, benchmark::Counter::kIsRate);
  state.counters["largest_grey_difference"] = difference;
}
BENCHMARK(RenderEverySampleExactly)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(1);

}  // namespace
}  // namespace plumbline
