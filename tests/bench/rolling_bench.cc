// A rolling tyre measured against its reference, both passes, as `plumbline measure --reference`
// does: a point every 8 px, subsets of 33 px of order 2; displacement, strain, ground, contact and
// slip of every frame, written. Recorded by the virtual rig at 50 frames a second and 1.4 m/s: an
// arc of the lifted wheel for the reference, and the tyre rolling over flat ground on that arc. The
// answer is checked as it is timed; the baselines of the same run match the same pairs with nothing
// known of where the points are, and the left images alone.

#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "apps/rolling_run.h"
#include "apps/wheel_reference_run.h"
#include "io/series_writer.h"
#include "io/virtual_rig/virtual_rig.h"
#include "match/correlate_field.h"
#include "tests/support/held_pairs.h"
#include "tests/support/peak_memory.h"
#include "tests/support/true_wheel.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

using Clock = std::chrono::steady_clock;

constexpr double kDegrees = std::numbers::pi / 180;
constexpr double kLifted_rad = 6 * kDegrees;  // between frames of the lifted wheel
constexpr double kThickness_mm = 20;

double SecondsSince(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

std::vector<StereoFrame> PairsOf(const VirtualRig& rig) {
  std::vector<StereoFrame> pairs;
  for (int f = 0; f < rig.scenario().frames; ++f) {
    StereoFrame pair;
    pair.index = f;
    pair.time_s = rig.FrameTime(f);
    pair.left = rig.TakeImage(f, Side::kLeft);
    pair.right = rig.TakeImage(f, Side::kRight);
    pairs.push_back(std::move(pair));
  }
  return pairs;
}

WheelReference ReferenceOf(RigKind kind, int frames) {
  const Scenario lifted =
      testing::TurningBy(kLifted_rad, frames, MakeScenario("tyre-lifted", kind));
  const std::vector<StereoFrame> arc = PairsOf(VirtualRig(lifted));
  const auto open = [&] { return std::make_unique<testing::HeldPairs>(arc); };
  const auto go_on = [](const std::string&, std::int64_t, std::int64_t) { return true; };
  return *MeasureWheelReference(lifted.rig, open, {}, go_on).wheel;
}

Scenario FlatGround(RigKind kind, int frames) {
  Scenario flat = MakeScenario("tyre-flat", kind);
  flat.frames = frames;
  return flat;
}

// A rig with the arc of a wheel for a reference, and the tyre rolling on that arc.
struct Recording {
  Recording(RigKind kind, int lifted_frames, int frames)
      : wheel(ReferenceOf(kind, lifted_frames)),
        rolling(FlatGround(kind, frames)),
        pairs(PairsOf(rolling)) {}

  WheelReference wheel;
  VirtualRig rolling;
  std::vector<StereoFrame> pairs;
};

const Recording& RecordingOf(int width) {
  static std::map<int, Recording> recordings;
  const auto found = recordings.find(width);
  if (found != recordings.end()) return found->second;
  // Reference images are some 15 degrees apart, frames 4: the tyre passes from one to the next.
  return width > 640 ? recordings.try_emplace(width, RigKind::kWide1280, 7, 8).first->second
                     : recordings.try_emplace(width, RigKind::kWide640, 10, 13).first->second;
}

RollingRunOptions Options() {
  RollingRunOptions options;
  options.sequence.field.step_px = 8;
  options.sequence.field.correlator.subset_px = 33;
  options.sequence.field.correlator.order = 2;
  options.survey.matching = options.sequence;
  return options;
}

RollingContactOptions ContactOptions() {
  RollingContactOptions contact;
  contact.carcass.thickness_mm = {kThickness_mm};
  const TyreOptions tyre;
  contact.free_rolling_radius_mm = MeasuredScalar{tyre.free_rolling_radius_mm, 0, {}};
  return contact;
}

fs::path Output() { return fs::path(PLUMBLINE_BINARY_DIR) / "rolling_bench.h5"; }

void Clear() {
  fs::remove(Output());
  fs::remove_all(Output().string() + ".parts");
}

// Nothing, or what is wrong with a frame.
std::string WrongWith(const SeriesFrame& frame, const VirtualRig& rolling) {
  const auto& tyre = std::get<TyreOptions>(rolling.scenario().surface);
  if (!frame.problem.empty()) return frame.problem;
  const Eigen::Vector3d up = rolling.GroundFromRig(frame.time_s).rotation.row(2);
  if (!(frame.ground.normal_in_rig.cross(up).norm() < 0.03 * kDegrees)) return "tilt is off";
  if (!(std::abs(frame.deformation.deflection_mm - tyre.deflection_mm) < 0.05)) {
    return "deflection is off";
  }
  if (!(std::abs(frame.slip.ratio) < 0.002)) return "slip is off";
  return "";
}

void RollingFrames(benchmark::State& state) {
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(1)));
  const Recording& recording = RecordingOf(static_cast<int>(state.range(0)));
  const auto count = static_cast<double>(recording.pairs.size());
  double prepare_s = 0, first_s = 0, survey_s = 0, contact_s = 0, match_s = 0, evaluate_s = 0,
         write_s = 0;
  for (auto _ : state) {
    auto begin = Clock::now();
    RollingRun run(recording.wheel, Options());
    prepare_s = SecondsSince(begin);
    testing::HeldPairs source(recording.pairs);
    begin = Clock::now();
    run.Survey(source, [&](std::int64_t done, std::int64_t) {
      if (done == 1) first_s = SecondsSince(begin);
      return true;
    });
    survey_s = SecondsSince(begin) - first_s;
    begin = Clock::now();
    run.FindContact(ContactOptions());
    contact_s = SecondsSince(begin);
    Clear();
    begin = Clock::now();
    SeriesHeader header = run.Header();
    match_s += SecondsSince(begin);  // the first reference image
    header.recipe_toml = "# benchmark";
    SeriesWriter writer(Output(), header);
    for (std::size_t f = 0; f < recording.pairs.size(); ++f) {
      const StereoRunFrame measured = run.Measure(recording.pairs[f], static_cast<std::int64_t>(f));
      match_s += measured.match_s;
      evaluate_s += measured.evaluate_s;
      if (const std::string wrong = WrongWith(measured.frame, recording.rolling); !wrong.empty()) {
        state.SkipWithError(("frame " + std::to_string(f) + ": " + wrong).c_str());
        return;
      }
      begin = Clock::now();
      writer.Commit(measured.frame);
      write_s += SecondsSince(begin);
    }
  }
  Clear();
  // The first frame, searched as a whole, and the index of the reference images are once a
  // recording, whatever its length.
  const double surveyed_s = survey_s * count / (count - 1);
  const double all_s = surveyed_s + contact_s + match_s + evaluate_s + write_s;
  state.counters["frames/s"] = count / all_s;
  state.counters["once_s"] = prepare_s + first_s;
  state.counters["survey%"] = 100 * surveyed_s / all_s;
  state.counters["contact%"] = 100 * contact_s / all_s;
  state.counters["match%"] = 100 * match_s / all_s;
  state.counters["evaluate%"] = 100 * evaluate_s / all_s;
  state.counters["write%"] = 100 * write_s / all_s;
  state.counters["peak_MB"] = testing::PeakMegabytes();
}

// A sequence of the reference image that the tyre in the middle of the recording is nearest to.
std::unique_ptr<StereoSequence> MiddleView(const Recording& recording) {
  const WheelReferenceView& view = recording.wheel.views[recording.wheel.views.size() / 2];
  return std::make_unique<StereoSequence>(recording.wheel.rig, view.left, view.right,
                                          Options().sequence);
}

// A baseline: one of the two matches of a frame, with nothing known of where its points are.
void MatchedAnew(benchmark::State& state) {
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(1)));
  const Recording& recording = RecordingOf(static_cast<int>(state.range(0)));
  const auto sequence = MiddleView(recording);
  const StereoFrame& pair = recording.pairs[recording.pairs.size() / 2];
  for (auto _ : state) {
    sequence->Restart();
    benchmark::DoNotOptimize(sequence->Add(pair.left, pair.right, pair.index));
  }
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

// A baseline: the points of one left image from where they are known to be, without verification
// or anything behind it.
void LeftImagesAlone(benchmark::State& state) {
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(1)));
  const Recording& recording = RecordingOf(static_cast<int>(state.range(0)));
  const WheelReferenceView& view = recording.wheel.views[recording.wheel.views.size() / 2];
  FieldOptions options = Options().sequence.field;
  options.verify = false;
  const FieldCorrelator correlator(view.left, options);
  const GrayImage& left = recording.pairs[recording.pairs.size() / 2].left;
  const PlanarField known = correlator.Correlate(left).field;
  for (auto _ : state) {
    benchmark::DoNotOptimize(correlator.Correlate(left, {.prior = &known}));
  }
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

void Sizes(benchmark::internal::Benchmark* bench) {
  bench->ArgNames({"width", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
  for (const int width : {640, 1280}) {
    for (const int threads : {1, 2}) bench->Args({width, threads});
  }
}

BENCHMARK(RollingFrames)->Apply(Sizes)->Iterations(1);
BENCHMARK(MatchedAnew)->Apply(Sizes)->Iterations(1);
BENCHMARK(LeftImagesAlone)->Apply(Sizes)->Iterations(5);

}  // namespace
}  // namespace plumbline
