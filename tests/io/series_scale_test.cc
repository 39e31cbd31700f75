#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <string>

#include "io/series_reader.h"
#include "io/series_writer.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::SmallFrame;
using testing::SmallHeader;
using testing::TestFolder;

constexpr ImageSize kGrid{150, 100};  // 0.8 MB a frame

// The most memory that this process has had, since it was started: unlike ru_maxrss, without what
// its parent had.
long PeakKilobytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return std::stol(line.substr(6));
  }
  return -1;
}

// Run by the test below in a process of its own: writes and reads a series, and tells its peak.
TEST(SeriesMemoryChild, DISABLED_WritesAndReadsManyFrames) {
  const char* file = std::getenv("PLUMBLINE_SERIES_CHILD");
  const char* frames = std::getenv("PLUMBLINE_SERIES_FRAMES");
  if (file == nullptr || frames == nullptr) GTEST_SKIP() << "a part of SeriesMemory";
  SeriesWriter writer(file, SmallHeader(kGrid));
  for (int i = 0; i < std::atoi(frames); ++i) writer.Commit(SmallFrame(i, kGrid));
  writer.Close();
  const SeriesReader reader(file);
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    if (reader.Frame(i).surface.position_mm.empty()) return;
  }
  std::ofstream(std::string(file) + ".peak") << PeakKilobytes();
}

long PeakOfARun(const fs::path& file, int frames) {
  const pid_t child = fork();
  if (child == 0) {
    setenv("PLUMBLINE_SERIES_CHILD", file.c_str(), 1);
    setenv("PLUMBLINE_SERIES_FRAMES", std::to_string(frames).c_str(), 1);
    if (std::freopen("/dev/null", "w", stdout) == nullptr) _exit(1);
    execl("/proc/self/exe", "series", "--gtest_also_run_disabled_tests",
          "--gtest_filter=SeriesMemoryChild.DISABLED_WritesAndReadsManyFrames", nullptr);
    _exit(1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  long peak = -1;
  std::ifstream(file.string() + ".peak") >> peak;
  return status == 0 ? peak : -1;
}

TEST(SeriesMemory, PeakDoesNotGrowWithTheNumberOfFrames) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the address sanitizer keeps freed memory, so that the peak tells nothing";
#endif
  const fs::path folder = TestFolder();
  const long few = PeakOfARun(folder / "few.h5", 10);
  const long many = PeakOfARun(folder / "many.h5", 100);
  ASSERT_GT(few, 0);
  ASSERT_GT(many, 0);
  EXPECT_EQ(SeriesReader(folder / "many.h5").frame_count(), 100);
  EXPECT_LT(static_cast<double>(many), 1.2 * static_cast<double>(few));
  RecordProperty("peak_kb_10_frames", static_cast<int>(few));
  RecordProperty("peak_kb_100_frames", static_cast<int>(many));
}

TEST(SeriesThreads, TheFileIsTheSameForAnyNumberOfThreads) {
  const fs::path folder = TestFolder();
  const ImageSize grid{700, 401};  // several bands a frame
  SeriesHeader header = SmallHeader(grid);
  for (int i = 0; i < 5; ++i) {
    header.inputs.push_back(folder / ("in" + std::to_string(i)));
    std::ofstream(header.inputs.back()) << i;
  }
  for (const int threads : {1, 2}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(threads));
    SeriesWriter writer(folder / ("threads" + std::to_string(threads) + ".h5"), header);
    for (int i = 0; i < 2; ++i) writer.Commit(SmallFrame(i, grid));
    writer.Close();
  }
  const auto compared = testing::RunPython(R"py(
import sys, h5py
a, b = (h5py.File(f'{sys.argv[1]}/threads{n}.h5', 'r') for n in (1, 2))
names = []
a.visititems(lambda name, o: names.append(name) if isinstance(o, h5py.Dataset) else None)
chunks = 0
for name in names:
    x, y = a[name], b[name]
    assert x.dtype == y.dtype and x.shape == y.shape, name
    if x.dtype == object: assert (x[()] == y[()]) if x.ndim == 0 else list(x[()]) == list(y[()]), name
    else: assert x[()].tobytes() == y[()].tobytes(), name
    if x.chunks is None: continue
    for k in range(x.id.get_num_chunks()):
        at = x.id.get_chunk_info(k).chunk_offset
        assert x.id.read_direct_chunk(at) == y.id.read_direct_chunk(at), (name, at)
        chunks += 1
assert a.attrs['inputs'] == b.attrs['inputs'] and len(names) > 40 and chunks > 50, chunks
print('same')
)py",
                                           folder.string());
  EXPECT_THAT(compared.output, ::testing::HasSubstr("same"));
}

}  // namespace
}  // namespace plumbline
