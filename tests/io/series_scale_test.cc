#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cstdlib>
#include <fstream>
#include <string>

#include "io/series_reader.h"
#include "io/series_writer.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/series_fixture.h"
#include "tests/io/series_processes.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::SmallFrame;
using testing::SmallHeader;
using testing::TestFolder;

constexpr ImageSize kGrid{150, 100};  // 0.8 MB a frame

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
  std::ofstream(std::string(file) + ".peak") << testing::PeakKilobytes();
}

TEST(SeriesMemory, PeakDoesNotGrowWithTheNumberOfFrames) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the address sanitizer keeps freed memory, so that the peak tells nothing";
#endif
  const fs::path folder = TestFolder();
  const char* test = "SeriesMemoryChild.DISABLED_WritesAndReadsManyFrames";
  const long few = testing::PeakOfARun(test, folder / "few.h5", 10);
  const long many = testing::PeakOfARun(test, folder / "many.h5", 100);
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
  testing::ExpectSameStoredBytes(folder / "threads1.h5", folder / "threads2.h5", 40, 50);
}

}  // namespace
}  // namespace plumbline
