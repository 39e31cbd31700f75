// Stereo-DIC of 1280x1024 pairs, a point every 8 px, subsets of 33 px: displacement, covariance and
// strain of every frame, written, in the flow of `plumbline measure`, from pairs in memory. The
// answer is checked before it is timed; the baseline of the same run is the correlation of the left
// images alone, without verification or anything behind it.

#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "apps/internal/measure_flow.h"
#include "apps/stereo_run.h"
#include "io/series_writer.h"
#include "match/correlate_field.h"
#include "tests/support/peak_memory.h"
#include "tests/support/rendered_surface.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

using Clock = std::chrono::steady_clock;
using testing::SpeckledSheet;

constexpr ImageSize kSize{1280, 1024};
constexpr int kPairs = 17;  // rendered; run through to and fro
constexpr double kNoiseGrey = 1.5;
constexpr double kStretchAFrame = 0.002;

StereoRig RigWithModes() {
  StereoRig rig = testing::ConvergentRig(kSize, 4700, 500, 130);
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  constexpr int kModes = 12;
  const Eigen::VectorXd sizes =
      rig.Parameters().cwiseAbs() * 1e-5 + Eigen::VectorXd::Constant(rig.ParameterCount(), 1e-6);
  rig.modes.modes = Eigen::MatrixXd(kModes, rig.ParameterCount());
  for (int k = 0; k < kModes; ++k) {
    for (int p = 0; p < rig.ParameterCount(); ++p) {
      rig.modes.modes(k, p) = normal(random) * sizes[p];
    }
  }
  return rig;
}

SpeckledSheet SheetAt(int frame) {
  SpeckledSheet sheet;
  sheet.px_per_mm = 9;
  sheet.rig_from_sheet = Rigid3::FromRotationVector({0.05, -0.1, 0.02}, {0, 0, 500});
  sheet.stretch(0, 0) = 1 + kStretchAFrame * frame;
  return sheet;
}

struct Recording {
  StereoRig rig = RigWithModes();
  std::vector<StereoFrame> pairs;

  Recording() {
    for (int k = 0; k < kPairs; ++k) {
      StereoFrame pair;
      pair.index = k;
      pair.time_s = k;
      const auto seed = static_cast<std::uint32_t>(2 * k);
      pair.left = SheetAt(k).Left(rig, kNoiseGrey, seed);
      pair.right = SheetAt(k).Right(rig, kNoiseGrey, seed + 1);
      pairs.push_back(std::move(pair));
    }
  }
  // To and fro, without the reference pair itself.
  StereoFrame At(std::int64_t frame) const {
    constexpr int kPeriod = 2 * (kPairs - 2);
    const auto place = static_cast<int>((frame - 1) % kPeriod);
    StereoFrame pair =
        pairs[static_cast<std::size_t>(1 + (place <= kPairs - 2 ? place : kPeriod - place))];
    pair.index = frame;
    pair.time_s = static_cast<double>(frame);
    return pair;
  }
};

const Recording& Pairs() {
  static const Recording recording;
  return recording;
}

StereoRunOptions Options() {
  StereoRunOptions options;
  options.sequence.field.step_px = 8;
  options.sequence.field.correlator.subset_px = 33;
  options.sequence.field.correlator.noise = NoiseModel{kNoiseGrey * kNoiseGrey, 0};
  options.block_frames = 1 << 30;
  return options;
}

fs::path Output() { return fs::path(PLUMBLINE_BINARY_DIR) / "stereo_bench.h5"; }

void Clear() {
  fs::remove(Output());
  fs::remove_all(Output().string() + ".parts");
}

bool IsRight(const StereoRunFrame& measured) {
  const double e = kStretchAFrame;  // of the first frame after the reference
  return measured.summary.valid_points * 10 > measured.summary.grid_points * 9 &&
         std::abs(measured.summary.strain.x() - (e + e * e / 2)) < 2e-5;
}

// Pairs of the recording without end, from the second one on.
class EndlessPairs : public ImageSource {
 public:
  explicit EndlessPairs(const Recording& recording) : recording_(recording) {}
  std::int64_t DeclaredCount() const override { return 0; }
  std::optional<StereoFrame> Next() override { return recording_.At(++frame_); }
  std::vector<std::string> Notes() const override { return {}; }
  std::vector<fs::path> Files() const override { return {}; }

 private:
  const Recording& recording_;
  std::int64_t frame_ = 1;
};

// Frames that go through the flow at a stretch.
constexpr std::int64_t kStretch = 15;

void StereoDicFrames(benchmark::State& state) {
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(0)));
  const Recording& recording = Pairs();
  StereoRun run(recording.rig, recording.pairs[0], Options());
  if (!IsRight(run.Measure(recording.At(1), 1))) {
    state.SkipWithError("the strain is not what the sheet was stretched by");
    return;
  }
  Clear();
  SeriesHeader header = run.Header();
  header.recipe_toml = "# benchmark";
  std::int64_t points = 0, frames = 0;
  double match_s = 0, evaluate_s = 0, write_s = 0;
  EndlessPairs pairs(recording);
  {
    SeriesWriter writer(Output(), header);
    const auto measure = [&](const StereoFrame& pair, std::int64_t) {
      StereoRunFrame measured = run.Measure(pair, pair.index);
      match_s += measured.match_s;
      evaluate_s += measured.evaluate_s;
      points += measured.summary.valid_points;
      return internal::ReportedFrame{std::move(measured.frame), {}, {}, 0};
    };
    const auto write = [&](const internal::ReportedFrame& measured) {
      const auto begin = Clock::now();
      writer.Commit(measured.frame);
      write_s += std::chrono::duration<double>(Clock::now() - begin).count();
      ++frames;
    };
    while (state.KeepRunningBatch(kStretch)) {
      internal::RunFlow(pairs, {0, 0, kStretch}, measure, write, [] { return false; });
    }
  }
  Clear();
  const double all_s = match_s + evaluate_s + write_s;
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(frames), benchmark::Counter::kIsRate);
  state.counters["points"] = static_cast<double>(points) / static_cast<double>(frames);
  state.counters["match%"] = 100 * match_s / all_s;
  state.counters["evaluate%"] = 100 * evaluate_s / all_s;
  state.counters["write%"] = 100 * write_s / all_s;
}

// The baseline: points of the left images alone.
void LeftImagesAlone(benchmark::State& state) {
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(0)));
  const Recording& recording = Pairs();
  FieldOptions options = Options().sequence.field;
  options.verify = false;
  const FieldCorrelator correlator(recording.pairs[0].left, options);
  PlanarField before = correlator.Correlate(recording.pairs[1].left).field;
  std::int64_t frame = 1;
  for (auto _ : state) {
    before = correlator.Correlate(recording.At(++frame).left, {.prior = &before}).field;
  }
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

// The most memory after 50 frames and after 500 (of this process: run it alone).
void PeakMemory(benchmark::State& state) {
  const Recording& recording = Pairs();
  StereoRun run(recording.rig, recording.pairs[0], Options());
  for (auto _ : state) {
    Clear();
    SeriesHeader header = run.Header();
    header.recipe_toml = "# benchmark";
    SeriesWriter writer(Output(), header);
    for (std::int64_t frame = 1; frame <= 500; ++frame) {
      writer.Commit(run.Measure(recording.At(frame), frame).frame);
      if (frame == 50) state.counters["MB at 50"] = testing::PeakMegabytes();
    }
    state.counters["MB at 500"] = testing::PeakMegabytes();
  }
  Clear();
}

BENCHMARK(StereoDicFrames)
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(LeftImagesAlone)
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(PeakMemory)->Iterations(1)->UseRealTime()->Unit(benchmark::kSecond);

}  // namespace
}  // namespace plumbline
