// Speed of the correlator: single matches from a start a pixel off, whole fields with seeds and
// verification, and a plain scalar implementation of the same algorithm as baseline.
#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>

#include <cmath>
#include <optional>

#include "io/image_source.h"
#include "match/correlate_field.h"
#include "match/internal/normal_equations.h"
#include "match/internal/subset_sums.h"
#include "tests/support/rendered_speckle.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

constexpr int kRadius = 16;

struct Pair {
  GrayImage reference, deformed;
  bool known = false;  // rendered: moved by kShift, stretched by kStretch about the middle
};
const Eigen::Vector2d kShift(0.3, -0.4);
constexpr double kStretch = 0.002;
constexpr int kSide = 900;

const Pair& Rendered() {
  static const Pair pair = [] {
    const ImageSize size{kSide, kSide};
    const Eigen::Vector2d middle(kSide / 2, kSide / 2);
    return Pair{testing::RenderSpeckle(
                    size, [](const Eigen::Vector2d& p) { return p; }, 1, 1),
                testing::RenderSpeckle(
                    size,
                    [=](const Eigen::Vector2d& p) {
                      return Eigen::Vector2d(middle + (p - middle - kShift) / (1 + kStretch));
                    },
                    1, 2),
                true};
  }();
  return pair;
}

// Sample 12 of the 2D-DIC challenge, images 0 and 4; nothing without ../shared/data.
const std::optional<Pair>& Sample12() {
  static const std::optional<Pair> pair = []() -> std::optional<Pair> {
    const auto folder = testing::SharedData("dic2d-challenge-S12-oht-cfrp");
    if (!folder) return std::nullopt;
    return Pair{ReadImage(*folder / "images" / "oht_cfrp_00.tiff"),
                ReadImage(*folder / "images" / "oht_cfrp_04.tiff")};
  }();
  return pair;
}

// Whole pixels, as an FFT search would give them.
SubsetWarp StartAt(const Pair& pair, const Eigen::Vector2i& pixel, const PlanarField* field,
                   int row, int column) {
  Eigen::Vector2d displacement = kShift;
  if (pair.known) {
    displacement += kStretch * (pixel.cast<double>() - Eigen::Vector2d(kSide / 2, kSide / 2));
  } else {
    displacement = field->displacement_px(row, column);
  }
  return SubsetWarp::Of(displacement.array().round().matrix());
}

FieldOptions OptionsOf(Interpolation interpolation, int order, int step_px, Prefilter filter) {
  FieldOptions options;
  options.image.interpolation = interpolation;
  options.image.prefilter = filter;
  options.correlator.order = order;
  options.correlator.max_iterations = 10;
  options.step_px = step_px;
  return options;
}

// range: 0 interpolation (3, 5), 1 order, 2 threads, 3 image (0 rendered, 1 sample 12), 4 filter.
void MatchSubsets(benchmark::State& state) {
  if (state.range(3) == 1 && !Sample12()) {
    state.SkipWithError("no ../shared/data");
    return;
  }
  const Pair& pair = state.range(3) == 1 ? *Sample12() : Rendered();
  const auto filter = state.range(4) == 1 ? Prefilter::kLowPass : Prefilter::kNone;
  const FieldOptions options =
      OptionsOf(static_cast<Interpolation>(state.range(0)), static_cast<int>(state.range(1)),
                state.range(3) == 1 ? 3 : 5, filter);
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(2)));
  const FieldCorrelator fields(pair.reference, options);
  const CorrelatedField once = fields.Correlate(pair.deformed);
  std::vector<std::pair<Eigen::Vector2i, SubsetWarp>> wanted;
  for (int r = 0; r < once.field.size().height; ++r) {
    for (int c = 0; c < once.field.size().width; ++c) {
      if (once.field.status(r, c) != Status::kOk) continue;
      const Eigen::Vector2i pixel = once.field.PixelOf(r, c).cast<int>();
      wanted.emplace_back(pixel, StartAt(pair, pixel, &once.field, r, c));
    }
  }
  const CorrelationImage reference(pair.reference, options.image);
  const CorrelationImage deformed(pair.deformed, options.image);
  const SubsetCorrelator correlator(reference, options.correlator);
  // The answer first.
  double squares = 0;
  std::int64_t iterations = 0;
  for (const auto& [pixel, start] : wanted) {
    const SubsetMatch match = correlator.Match(deformed, pixel, start);
    iterations += match.iterations;
    if (!pair.known) continue;
    const Eigen::Vector2d truth =
        kShift + kStretch * (pixel.cast<double>() - Eigen::Vector2d(kSide / 2, kSide / 2));
    squares += (match.warp.displacement_px() - truth).squaredNorm();
  }
  const auto count = static_cast<double>(wanted.size());
  if (std::sqrt(squares / count) > 0.03) {
    state.SkipWithError("wrong displacements");
    return;
  }
  for (auto _ : state) {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, wanted.size(), 64), [&](const auto& some) {
      for (std::size_t i = some.begin(); i != some.end(); ++i) {
        benchmark::DoNotOptimize(correlator.Match(deformed, wanted[i].first, wanted[i].second));
      }
    });
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(wanted.size()));
  state.counters["points"] = count;
  state.counters["iterations"] = static_cast<double>(iterations) / count;
  state.SetLabel(internal::SumsInstructionSet());
}

// The same algorithm from the plain sums, on some of the points. range: 0 interpolation, 1 order.
void MatchSubsetsScalar(benchmark::State& state) {
  const Pair& pair = Rendered();
  CorrelationImageOptions options;
  options.interpolation = static_cast<Interpolation>(state.range(0));
  options.prefilter = Prefilter::kNone;
  const int order = static_cast<int>(state.range(1));
  const CorrelationImage reference(pair.reference, options);
  const CorrelationImage deformed(pair.deformed, options);
  const internal::SubsetOutline outline = internal::SubsetOutline::Square(kRadius);
  const internal::ReferencePlanes planes{&reference.grey(),
                                         &reference.gradient_x(),
                                         &reference.gradient_y(),
                                         nullptr,
                                         nullptr,
                                         nullptr};
  internal::PackedSubset subset;
  const auto match = [&](const Eigen::Vector2i& pixel) {
    const int count = internal::Pack(planes, outline, pixel.x(), pixel.y(), 120, subset);
    const internal::NormalEquations equations(
        order, count, SumReferenceScalar(subset, order),
        SumProductsScalar(subset, subset.gradient_x, subset.gradient_y, order));
    SubsetWarp warp = StartAt(pair, pixel, nullptr, 0, 0);
    for (int i = 0; i < 10; ++i) {
      internal::TargetPixels target;
      target.coefficients = deformed.coefficients() + pixel.y() * deformed.stride() + pixel.x();
      target.stride = deformed.stride();
      target.degree = deformed.degree();
      target.grey_offset = 120;
      for (int k = 0; k < 6; ++k) {
        target.warp_x[k] = static_cast<float>(warp.c(0, k) + (k == 1 ? 1 : 0));
        target.warp_y[k] = static_cast<float>(warp.c(1, k) + (k == 2 ? 1 : 0));
      }
      SubsetWarp step;
      if (!equations.Step(equations.Evaluate(SumTargetScalar(subset, target, order)), 0, step)) {
        break;
      }
      warp = Compose(warp, Inverse(step));
      if (internal::NormalEquations::MeanSquareShift(step, kRadius) < 1e-6) break;
    }
    benchmark::DoNotOptimize(equations.CovariancePerVariance(nullptr));
    return warp;
  };
  std::vector<Eigen::Vector2i> pixels;
  for (int y = 50; y < kSide - 50; y += 40) {
    for (int x = 50; x < kSide - 50; x += 40) pixels.emplace_back(x, y);
  }
  for (const Eigen::Vector2i& pixel : pixels) {
    const Eigen::Vector2d truth =
        kShift + kStretch * (pixel.cast<double>() - Eigen::Vector2d(kSide / 2, kSide / 2));
    if ((match(pixel).displacement_px() - truth).norm() > 0.1) {
      state.SkipWithError("wrong displacements");
      return;
    }
  }
  for (auto _ : state) {
    for (const Eigen::Vector2i& pixel : pixels) benchmark::DoNotOptimize(match(pixel));
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(pixels.size()));
}

// From two images to a verified field, seeds included. range: 0 interpolation, 1 threads,
// 2 verification.
void WholeField(benchmark::State& state) {
  const Pair& pair = Sample12() ? *Sample12() : Rendered();
  FieldOptions options =
      OptionsOf(static_cast<Interpolation>(state.range(0)), 1, 3, Prefilter::kLowPass);
  options.verify = state.range(2) == 1;
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(state.range(1)));
  const FieldCorrelator correlator(pair.reference, options);
  std::int64_t points = 0;
  for (auto _ : state) {
    const CorrelatedField found = correlator.Correlate(pair.deformed);
    points += found.counts.points;
    if (found.counts.ok * 10 < found.counts.points * 6) state.SkipWithError("too few points");
  }
  state.SetItemsProcessed(points);
}

// Target sums alone: the arithmetic limit. range: 0 interpolation, 1 order, 2 scalar twin.
void TargetSums(benchmark::State& state) {
  CorrelationImageOptions options;
  options.interpolation = static_cast<Interpolation>(state.range(0));
  options.prefilter = Prefilter::kNone;
  const CorrelationImage image(Rendered().reference, options);
  const internal::SubsetOutline outline = internal::SubsetOutline::Square(kRadius);
  const internal::ReferencePlanes planes{
      &image.grey(), &image.gradient_x(), &image.gradient_y(), nullptr, nullptr, nullptr};
  internal::PackedSubset subset;
  internal::Pack(planes, outline, 400, 400, 120, subset);
  internal::TargetPixels target;
  target.coefficients = image.coefficients() + 400 * image.stride() + 400;
  target.stride = image.stride();
  target.degree = image.degree();
  target.grey_offset = 120;
  target.warp_x[0] = 0.3F;
  target.warp_x[1] = 1.002F;
  target.warp_y[0] = 0.2F;
  target.warp_y[2] = 1.001F;
  const int order = static_cast<int>(state.range(1));
  const double fast = SumTarget(subset, target, order).fg;
  const double plain = SumTargetScalar(subset, target, order).fg;
  if (std::abs(fast - plain) > 1e-5 * std::abs(plain)) {
    state.SkipWithError("the sums differ from their plain twin");
    return;
  }
  for (auto _ : state) {
    benchmark::DoNotOptimize(state.range(2) == 1 ? SumTargetScalar(subset, target, order)
                                                 : SumTarget(subset, target, order));
  }
  // Multiply-adds of a pixel, padding not counted: interpolation, its weights, the sums.
  const double taps = options.interpolation == Interpolation::kCubic ? 4 : 6;
  const double weights = options.interpolation == Interpolation::kCubic ? 12 : 36;
  const double operations = taps * taps + taps + weights + (order == 1 ? 13 : 20);
  state.counters["GFLOP/s"] =
      benchmark::Counter(2 * operations * 33 * 33 * static_cast<double>(state.iterations()) * 1e-9,
                         benchmark::Counter::kIsRate);
}

BENCHMARK(MatchSubsets)
    ->ArgNames({"degree", "order", "threads", "sample12", "filter"})
    ->Args({3, 1, 1, 0, 0})
    ->Args({3, 1, 2, 0, 0})
    ->Args({3, 2, 1, 0, 0})
    ->Args({3, 2, 2, 0, 0})
    ->Args({5, 1, 1, 0, 0})
    ->Args({5, 1, 1, 0, 1})
    ->Args({5, 1, 2, 0, 1})
    ->Args({5, 2, 1, 0, 1})
    ->Args({5, 2, 2, 0, 1})
    ->Args({3, 1, 1, 1, 0})
    ->Args({3, 1, 2, 1, 0})
    ->Args({3, 2, 1, 1, 0})
    ->Args({3, 2, 2, 1, 0})
    ->Args({5, 1, 1, 1, 1})
    ->Args({5, 1, 2, 1, 1})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(MatchSubsetsScalar)
    ->ArgNames({"degree", "order"})
    ->Args({3, 1})
    ->Args({3, 2})
    ->Args({5, 1})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(WholeField)
    ->ArgNames({"degree", "threads", "verify"})
    ->Args({3, 1, 0})
    ->Args({3, 1, 1})
    ->Args({3, 2, 1})
    ->Args({5, 1, 1})
    ->Args({5, 2, 1})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(TargetSums)
    ->ArgNames({"degree", "order", "scalar"})
    ->Args({3, 1, 0})
    ->Args({3, 1, 1})
    ->Args({3, 2, 0})
    ->Args({5, 1, 0})
    ->Args({5, 1, 1})
    ->Args({5, 2, 0});

}  // namespace
}  // namespace plumbline
