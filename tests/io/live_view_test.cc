// What readers can follow while a run goes on.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "io/inspect.h"
#include "io/series_reader.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/planar_fixture.h"
#include "tests/io/series_comparison.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::FullFrame;
using testing::FullHeader;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::TestFolder;

constexpr LiveReading kOften{.every_s = 1e-6, .largest_load = 1};

// Commits frames until the view has shown so many segments; returns how many frames.
template <typename Writer, typename FrameOf>
int CommitUntilSegments(Writer& writer, const fs::path& parts, int segments, int first,
                        const FrameOf& frame_of) {
  const fs::path last = parts / ("segment-00000" + std::to_string(segments - 1) + ".h5");
  int i = first;
  for (; i < first + 400 && !fs::exists(last); ++i) {
    writer.Commit(frame_of(i));
    usleep(20'000);
  }
  EXPECT_TRUE(fs::exists(last));
  EXPECT_EQ(writer.live_problem(), "");
  return i;
}

TEST(LiveView, ReadsLikeAFinishedSeriesWhileTheRunGoesOn) {
  const fs::path file = TestFolder() / "run.h5";
  const fs::path parts = file.string() + ".parts";
  SeriesWriter writer(file, FullHeader(), SeriesStart::kNew, kOften);
  const int committed =
      CommitUntilSegments(writer, parts, 3, 0, [](int i) { return FullFrame(i); });
  for (int k = 0; k < 200 && SeriesReader(parts / "live.h5").frame_count() < 3; ++k) usleep(20'000);
  EXPECT_THAT(Validate(parts / "live.h5"), IsEmpty());
  {
    const SeriesReader reader(parts / "live.h5");
    EXPECT_TRUE(reader.facts().goes_on);
    EXPECT_GE(reader.frame_count(), 3);
    EXPECT_LE(reader.frame_count(), committed);
    for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
      testing::ExpectSameFrame(FullFrame(i), reader.Frame(i));
    }
    EXPECT_THAT(Inspect(parts / "live.h5").Text(), HasSubstr("the run goes on"));
    EXPECT_EQ(Inspect(parts / "live.h5").contents, FullHeader().contents);
  }
  testing::WalkWithH5py(parts / "live.h5", R"py(
assert f.attrs['run_goes_on'] == 1 and count > 200
n = len(f['frames/index'])
assert n >= 3 and f['surface/position'].is_virtual and f['surface/position'].shape == (n, 5, 7, 3)
assert n == sum(f['sources/frames'])
k = np.arange(35).reshape(5, 7)
for i in range(n):
    ok = k % 5 != 3
    assert np.array_equal(np.isfinite(f['surface/position'][i, ..., 0]), ok), i
    np.testing.assert_allclose(f['surface/position'][i][ok][:, 1], 2 * (i + .1 * k[ok]), rtol=1e-6)
check_nexus('surface', 'strain', 'patch', 'slip')
print('walked')
)py");
  writer.Close();
  EXPECT_FALSE(fs::exists(parts));
  const SeriesReader reader(file);
  EXPECT_FALSE(reader.facts().goes_on);
  EXPECT_EQ(reader.frame_count(), committed);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(LiveView, OfOneCameraTooAndAfterAResume) {
  const fs::path file = TestFolder() / "run.h5";
  const fs::path parts = file.string() + ".parts";
  const PlanarSeriesHeader header = testing::PlanarHeader();
  const auto frame_of = [&](int i) { return testing::PlanarFrame(i, header); };
  int committed = 0;
  {
    PlanarSeriesWriter writer(file, header, SeriesStart::kNew, kOften);
    committed = CommitUntilSegments(writer, parts, 2, 0, frame_of);
  }
  EXPECT_TRUE(fs::exists(parts / "live.h5"));  // of the run that was broken off
  PlanarSeriesWriter writer(file, header, SeriesStart::kResume, kOften);
  EXPECT_FALSE(fs::exists(parts / "segment-000001.h5"));
  ASSERT_EQ(writer.committed(), committed);
  committed = CommitUntilSegments(writer, parts, 2, committed, frame_of);
  for (int k = 0; k < 200 && !fs::exists(parts / "live.h5"); ++k) usleep(20'000);
  const PlanarSeriesReader reader(parts / "live.h5");
  EXPECT_TRUE(reader.facts().goes_on);
  ASSERT_GT(reader.frame_count(), 2);
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    testing::ExpectSamePlanarFrame(frame_of(static_cast<int>(i)), reader.Frame(i));
  }
  writer.Close();
  EXPECT_EQ(PlanarSeriesReader(file).frame_count(), committed);
}

TEST(LiveView, WhatGoesWrongWithItDoesNotEndTheRun) {
  const fs::path file = TestFolder() / "run.h5";
  const fs::path parts = file.string() + ".parts";
  SeriesWriter writer(file, FullHeader(), SeriesStart::kNew, kOften);
  fs::create_directory(parts / "segment-000000.h5");  // its name is taken
  std::ofstream(parts / "segment-000000.h5/x") << 'x';
  int i = 0;
  for (; i < 400 && writer.live_problem().empty(); ++i) {
    writer.Commit(FullFrame(i));
    usleep(5'000);
  }
  EXPECT_THAT(writer.live_problem(), HasSubstr("segment-000000.h5"));
  writer.Commit(FullFrame(i++));
  fs::remove_all(parts / "segment-000000.h5");
  writer.Close();
  EXPECT_EQ(SeriesReader(file).frame_count(), i);
  EXPECT_THAT(Validate(file), IsEmpty());
}

TEST(LiveView, CanBeLeftOut) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesWriter writer(file, FullHeader(), SeriesStart::kNew, {.every_s = 0});
  for (int i = 0; i < 5; ++i) writer.Commit(FullFrame(i));
  EXPECT_FALSE(fs::exists(file.string() + ".parts/segment-000000.h5"));
  writer.Close();
}

}  // namespace
}  // namespace plumbline
