#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <cmath>

#include "track/surface_strain.h"

namespace plumbline {
namespace {

constexpr ImageSize kGrid{155, 123};
constexpr int kStepPx = 5, kSubsetPx = 21, kModes = 12;
constexpr double kStretch = 1.02;

// A cylinder of radius 200 mm, stretched along its axis.
SurfaceState InstantOf(double stretch) {
  SurfaceState instant;
  instant.point_mm = Image<Eigen::Vector3d>(kGrid, Eigen::Vector3d::Zero());
  Image<Eigen::Vector3f> along(kGrid, Eigen::Vector3f::Zero());
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      const double angle = 0.5 * (c - 77) / 200;
      instant.point_mm(r, c) = {200 * std::sin(angle), stretch * 0.5 * (r - 61),
                                600 - 200 * std::cos(angle)};
      along(r, c) = (1e-4 * instant.point_mm(r, c)).cast<float>();
    }
  }
  instant.d_left = Image<Eigen::Matrix<float, 3, 2>>(
      kGrid, (Eigen::Matrix<float, 3, 2>() << 0.1F, 0, 0, 0.1F, 0.3F, 0).finished());
  instant.d_right = instant.d_left;
  instant.scale_left = instant.scale_right = Image<float>(kGrid, 1);
  instant.share_left = instant.share_right = Image<float>(kGrid, 0.5F);
  instant.along_modes_mm.assign(kModes, along);
  return instant;
}

// One frame on one thread; one point in `missing_every` of the reference is missing now, 0: none.
void StrainOfAFrame(benchmark::State& state, int order, int missing_every) {
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
  SurfaceStrainOptions options;
  options.order = order;
  const SurfaceState now = InstantOf(kStretch);
  const SurfaceGauges gauges(InstantOf(1), Image<Eigen::Vector3f>(kGrid, {1e-4F, 0, 1e-4F}),
                             NeighbourCorrelation::OfOverlap(kGrid, kStepPx, kSubsetPx, 1), kStepPx,
                             kSubsetPx, options);
  Image<Status> status(kGrid, Status::kOk);
  for (std::size_t i = 0; missing_every > 0 && i < status.pixel_count();
       i += static_cast<std::size_t>(missing_every))
    status.data()[i] = Status::kLowCorrelation;
  for (auto _ : state) {
    const SurfaceStrain strain = gauges.Strain(now, status);
    const double expected = 0.5 * (kStretch * kStretch - 1);
    if (!(std::abs(strain.strain(61, 77)[1] - expected) < 1e-5))
      state.SkipWithError("wrong strain");
  }
  state.SetItemsProcessed(state.iterations() * kGrid.width * kGrid.height);
}
BENCHMARK_CAPTURE(StrainOfAFrame, order_1, 1, 0)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(StrainOfAFrame, order_2, 2, 0)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(StrainOfAFrame, order_1_one_in_500_missing, 1, 501)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(StrainOfAFrame, order_1_one_in_50_missing, 1, 51)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(StrainOfAFrame, order_2_one_in_50_missing, 2, 51)->Unit(benchmark::kMillisecond);

// The baseline: the gauges themselves, what each frame would cost if they were worked out again.
void GaugesOfTheReference(benchmark::State& state) {
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
  const SurfaceState reference = InstantOf(1);
  for (auto _ : state) {
    const SurfaceGauges gauges(reference, Image<Eigen::Vector3f>(kGrid, {1e-4F, 0, 1e-4F}),
                               NeighbourCorrelation::OfOverlap(kGrid, kStepPx, kSubsetPx, 1),
                               kStepPx, kSubsetPx);
    if (!gauges.axes()(61, 77).allFinite()) state.SkipWithError("no axes");
  }
  state.SetItemsProcessed(state.iterations() * kGrid.width * kGrid.height);
}
BENCHMARK(GaugesOfTheReference)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace plumbline
