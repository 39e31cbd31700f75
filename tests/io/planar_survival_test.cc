// The series of one camera on bad days: killed runs, full disks, damaged files; and on long ones.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <signal.h>
#include <sys/resource.h>

#include <cstdlib>
#include <fstream>
#include <random>

#include "calib/error.h"
#include "io/inspect.h"
#include "tests/io/damaged_copies.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/planar_fixture.h"
#include "tests/io/series_processes.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::ExpectSamePlanarFrame;
using ::testing::IsEmpty;
using testing::PlanarFrame;
using testing::PlanarHeader;
using testing::TestFolder;
using testing::WritePlanar;

// Run by the test below in a process of its own: commits until it is killed, telling each commit.
TEST(PlanarSeriesChild, DISABLED_CommitsUntilKilled) {
  const char* file = std::getenv("PLUMBLINE_SERIES_CHILD");
  if (file == nullptr) GTEST_SKIP() << "a part of PlanarSeries.AKilledRunLosesNoCommittedFrame";
  const PlanarSeriesHeader header = PlanarHeader({70, 50});
  PlanarSeriesWriter writer(file, header);
  std::ofstream told(std::string(file) + ".told", std::ios::binary);
  for (int i = 0; i < 100'000; ++i) {
    writer.Commit(PlanarFrame(i, header));
    told << 'x' << std::flush;
  }
}

TEST(PlanarSeries, AKilledRunLosesNoCommittedFrame) {
  const fs::path folder = TestFolder();
  for (int round = 0; round < 5; ++round) {
    const fs::path file = folder / ("run" + std::to_string(round) + ".h5");
    const std::int64_t reported =
        testing::KillWhileCommitting("PlanarSeriesChild.DISABLED_CommitsUntilKilled", file, round);
    ASSERT_GE(reported, 3);
    const RecoveredSeries recovered = RecoverSeries(file);
    EXPECT_GE(recovered.frames, reported);
    EXPECT_LE(recovered.frames, reported + 1);
    const PlanarSeriesReader reader(file);
    ASSERT_EQ(reader.frame_count(), recovered.frames);
    ExpectSamePlanarFrame(PlanarFrame(reported - 1, PlanarHeader({70, 50})),
                          reader.Frame(reported - 1));
    EXPECT_FALSE(fs::exists(file.string() + ".parts"));
    EXPECT_THAT(Validate(file), IsEmpty());
  }
}

TEST(PlanarSeries, RecoversUpToTheFirstDamagedByte) {
  const fs::path folder = TestFolder();
  std::mt19937 rng(2);
  for (int round = 0; round < 10; ++round) {
    const fs::path file = folder / ("run" + std::to_string(round) + ".h5");
    {
      PlanarSeriesWriter writer(file, PlanarHeader());
      for (int i = 0; i < 5; ++i) writer.Commit(PlanarFrame(i));
    }
    testing::DamageOneByte(file.string() + ".parts/journal", rng);
    const RecoveredSeries recovered = RecoverSeries(file);
    EXPECT_LT(recovered.frames, 5);
    EXPECT_GT(recovered.bytes_dropped, 0);
    const PlanarSeriesReader reader(file);
    for (std::int64_t i = 0; i < recovered.frames; ++i) {
      ExpectSamePlanarFrame(PlanarFrame(i), reader.Frame(i));
    }
  }
}

TEST(PlanarSeries, AFullDiskIsNamedAndKeepsTheCommittedFrames) {
  const fs::path file = TestFolder() / "run.h5";
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  signal(SIGXFSZ, SIG_IGN);
  {
    PlanarSeriesWriter writer(file, PlanarHeader());
    for (int i = 0; i < 3; ++i) writer.Commit(PlanarFrame(i));
    EXPECT_THROW(PlanarSeriesWriter(file, PlanarHeader()), InputError);  // unfinished
    rlimit small = before;
    small.rlim_cur = fs::file_size(file.string() + ".parts/journal") + 100;
    setrlimit(RLIMIT_FSIZE, &small);
    EXPECT_THROW(writer.Commit(PlanarFrame(3)), EnvironmentError);
    small.rlim_cur = 8192;  // no room for the packed file either
    setrlimit(RLIMIT_FSIZE, &small);
    EXPECT_THROW(writer.Close(), EnvironmentError);
    setrlimit(RLIMIT_FSIZE, &before);
  }
  EXPECT_EQ(RecoverSeries(file).frames, 3);
  ExpectSamePlanarFrame(PlanarFrame(2), PlanarSeriesReader(file).Frame(2));
}

TEST(PlanarSeries, SurvivesGarbledAndTruncatedFiles) {
  const fs::path file = TestFolder() / "good.h5";
  WritePlanar(file, PlanarHeader(), {PlanarFrame(0), PlanarFrame(1)});
  int read = 0;
  testing::ForGarbledCopies(file, [&](const fs::path& bad) {
    try {
      const PlanarSeriesReader reader(bad);
      for (std::int64_t i = 0; i < std::min<std::int64_t>(reader.frame_count(), 3); ++i) {
        reader.Frame(i);
      }
      ++read;
    } catch (const InputError&) {
    }
  });
  EXPECT_LT(read, 200);  // those that were cut off are refused
}

constexpr ImageSize kManyPoints{100, 60};  // 0.8 MB a frame

// Run by the test below in a process of its own: writes and reads a series, and tells its peak.
TEST(PlanarSeriesChild, DISABLED_WritesAndReadsManyFrames) {
  const char* file = std::getenv("PLUMBLINE_SERIES_CHILD");
  const char* frames = std::getenv("PLUMBLINE_SERIES_FRAMES");
  if (file == nullptr || frames == nullptr) GTEST_SKIP() << "a part of PlanarSeriesMemory";
  const PlanarSeriesHeader header = PlanarHeader(kManyPoints);
  PlanarSeriesWriter writer(file, header);
  std::mt19937 rng(5);
  for (int i = 0; i < std::atoi(frames); ++i) {
    PlanarSeriesFrame frame = PlanarFrame(i, header);
    // What does not compress: or else the journal's records would hardly count.
    for (auto& cov : frame.field.cov_gradient.values()) {
      for (float& v : cov) v = static_cast<float>(rng());
    }
    writer.Commit(frame);
  }
  writer.Close();
  const PlanarSeriesReader reader(file);
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    if (reader.Frame(i).field.displacement_px.empty()) return;
  }
  std::ofstream(std::string(file) + ".peak") << testing::PeakKilobytes();
}

TEST(PlanarSeriesMemory, PeakDoesNotGrowWithTheNumberOfFrames) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the address sanitizer keeps freed memory, so that the peak tells nothing";
#endif
  const fs::path folder = TestFolder();
  const char* test = "PlanarSeriesChild.DISABLED_WritesAndReadsManyFrames";
  const long few = testing::PeakOfARun(test, folder / "few.h5", 8);
  const long many = testing::PeakOfARun(test, folder / "many.h5", 64);
  ASSERT_GT(few, 0);
  ASSERT_GT(many, 0);
  EXPECT_EQ(PlanarSeriesReader(folder / "many.h5").frame_count(), 64);
  EXPECT_LT(static_cast<double>(many), 1.2 * static_cast<double>(few));
  RecordProperty("peak_kb_8_frames", static_cast<int>(few));
  RecordProperty("peak_kb_64_frames", static_cast<int>(many));
}

TEST(PlanarSeriesThreads, TheFileIsTheSameForAnyNumberOfThreads) {
  const fs::path folder = TestFolder();
  PlanarSeriesHeader header = PlanarHeader({300, 101});  // two bands a frame
  for (int i = 0; i < 5; ++i) {
    header.inputs.push_back(folder / ("in" + std::to_string(i)));
    std::ofstream(header.inputs.back()) << i;
  }
  for (const int threads : {1, 2}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(threads));
    WritePlanar(folder / ("threads" + std::to_string(threads) + ".h5"), header,
                {PlanarFrame(0, header), PlanarFrame(1, header)});
  }
  testing::ExpectSameStoredBytes(folder / "threads1.h5", folder / "threads2.h5", 40, 60);
}

}  // namespace
}  // namespace plumbline
