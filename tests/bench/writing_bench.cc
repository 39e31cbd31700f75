#include <benchmark/benchmark.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <random>
#include <vector>

#include "io/series_reader.h"
#include "io/series_writer.h"
#include "tests/io/series_fixture.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;

constexpr ImageSize kGrid{480, 300};

// A noisy tilted plane, of which one point in twenty is missing: deflate meets what it meets in
// measurements.
SeriesFrame MakeFrame() {
  SeriesFrame frame = testing::SmallFrame(0, kGrid);
  Surface& s = frame.surface;
  std::mt19937 rng(3);
  std::normal_distribution<float> noise;
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      const bool ok = rng() % 20 != 0;
      const float x = 0.2f * static_cast<float>(c), y = 0.2f * static_cast<float>(r);
      s.status(r, c) = ok ? Status::kOk : Status::kLowCorrelation;
      s.position_mm(r, c) = Eigen::Vector3f(x + 0.002f * noise(rng), y + 0.002f * noise(rng),
                                            380 + 0.1f * x + 0.01f * noise(rng));
      s.sigma_random_mm(r, c) = Eigen::Vector3f(2e-3f, 2e-3f, 1e-2f) * (1 + 0.1f * noise(rng));
      s.sigma_calibration_mm(r, c) = Eigen::Vector3f(x, y, 40) * 2e-4f;
      s.correlation(r, c) = 0.98f + 0.003f * noise(rng);
      s.epipolar_px(r, c) = 0.05f * noise(rng);
      if (!ok) {
        for (auto* image : {&s.position_mm, &s.sigma_random_mm, &s.sigma_calibration_mm}) {
          (*image)(r, c).setConstant(kNaN);
        }
      }
    }
  }
  return frame;
}

// The numbers of a surface as they lie in memory, one image after the other.
std::vector<char> RawBytes(const Surface& s) {
  std::vector<char> bytes;
  const auto add = [&](const auto& image) {
    const auto* from = reinterpret_cast<const char*>(image.data());
    bytes.insert(bytes.end(), from, from + image.pixel_count() * sizeof(*image.data()));
  };
  add(s.position_mm);
  add(s.sigma_random_mm);
  add(s.sigma_calibration_mm);
  add(s.correlation);
  add(s.epipolar_px);
  add(s.status);
  return bytes;
}

fs::path FreshFolder() {
  const fs::path folder = fs::path(PLUMBLINE_BINARY_DIR) / "bench_files";
  fs::remove_all(folder);
  fs::create_directories(folder);
  return folder;
}

bool ReadsBackTheSame(const fs::path& file, const SeriesFrame& frame) {
  SeriesWriter writer(file, testing::SmallHeader(kGrid));
  for (int i = 0; i < 2; ++i) writer.Commit(frame);
  writer.Close();
  const SeriesReader reader(file);
  return reader.frame_count() == 2 && RawBytes(reader.Frame(1).surface) == RawBytes(frame.surface);
}

void Count(benchmark::State& state, std::size_t bytes_a_frame) {
  state.SetItemsProcessed(state.iterations());
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(bytes_a_frame));
}

// Items are frames on the disk, bytes those that they have in memory.
void CommitFrame(benchmark::State& state) {
  const fs::path folder = FreshFolder();
  const SeriesFrame frame = MakeFrame();
  if (!ReadsBackTheSame(folder / "check.h5", frame)) {
    return state.SkipWithError("the file does not hold what was written");
  }
  {
    SeriesWriter writer(folder / "run.h5", testing::SmallHeader(kGrid));
    for (auto _ : state) writer.Commit(frame);
    const double on_disk = static_cast<double>(fs::file_size(folder / "run.h5.parts" / "journal"));
    Count(state, RawBytes(frame.surface).size());
    state.counters["disk_MB_a_frame"] = 1e-6 * on_disk / static_cast<double>(state.iterations());
  }
  fs::remove_all(folder);
}
BENCHMARK(CommitFrame)->Unit(benchmark::kMillisecond)->UseRealTime();

// The same with the packing into one file at the end: a run of ten frames.
void CommitTenFramesAndClose(benchmark::State& state) {
  const SeriesFrame frame = MakeFrame();
  for (auto _ : state) {
    state.PauseTiming();
    const fs::path folder = FreshFolder();
    state.ResumeTiming();
    SeriesWriter writer(folder / "run.h5", testing::SmallHeader(kGrid));
    for (int i = 0; i < 10; ++i) writer.Commit(frame);
    writer.Close();
  }
  Count(state, 10 * RawBytes(frame.surface).size());
  state.SetItemsProcessed(10 * state.iterations());
}
BENCHMARK(CommitTenFramesAndClose)->Unit(benchmark::kMillisecond)->UseRealTime();

// The baseline: the same numbers, neither compressed nor checksummed nor described, forced to the
// disk after each frame.
void PlainWriteAndSync(benchmark::State& state) {
  const fs::path folder = FreshFolder();
  const std::vector<char> bytes = RawBytes(MakeFrame().surface);
  std::FILE* file = std::fopen((folder / "raw").c_str(), "wb");
  if (file == nullptr) return state.SkipWithError("cannot write");
  for (auto _ : state) {
    const bool written = std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size() &&
                         std::fflush(file) == 0 && fsync(fileno(file)) == 0;
    if (!written) state.SkipWithError("cannot write");
  }
  std::fclose(file);
  Count(state, bytes.size());
  fs::remove_all(folder);
}
BENCHMARK(PlainWriteAndSync)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace plumbline
