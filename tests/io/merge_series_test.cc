#include "io/merge_series.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <fstream>

#include "calib/error.h"
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

constexpr int kFrames = 10;

// Of frame 4 only the images are known: it is in the middle of a shard.
SeriesFrame FrameOf(std::int64_t i, const SeriesHeader& header) {
  SeriesFrame frame = FullFrame(i, header.grid_px.size());
  if (i == 4) {
    frame.problem = "left4.png is truncated";
    frame.surface = {};
    frame.displacement = {};
    frame.strain = {};
    frame.match = {};
    frame.velocity = {};
    frame.material = {};
    frame.slip.velocity_mm_s = frame.slip.sigma_random_mm_s =
        frame.slip.sigma_calibration_mm_s = {};
  }
  return frame;
}
PlanarSeriesFrame FrameOf(std::int64_t i, const PlanarSeriesHeader& header) {
  PlanarSeriesFrame frame = testing::PlanarFrame(i, header);
  if (i == 4) {
    frame.problem = "image4.png is truncated";
    frame.field = {};
  }
  return frame;
}

template <typename Writer, typename Header>
void WriteRange(const fs::path& file, const Header& header, std::int64_t first, std::int64_t end) {
  Writer writer(file, header);
  for (std::int64_t i = first; i < end; ++i) writer.Commit(FrameOf(i, header));
  writer.Close();
}

// shard0.h5 and so on, and whole.h5, the run that was not cut.
template <typename Writer, typename Header>
std::vector<fs::path> WriteShards(const fs::path& folder, Header header, int count) {
  WriteRange<Writer>(folder / "whole.h5", header, 0, kFrames);
  std::vector<fs::path> files;
  for (int i = 0; i < count; ++i) {
    header.shard = ShardOf(i, count, kFrames);
    files.push_back(folder / ("shard" + std::to_string(i) + ".h5"));
    WriteRange<Writer>(files.back(), header, header.shard->first_frame, EndOf(*header.shard));
  }
  return files;
}
std::vector<fs::path> WriteStereoShards(const fs::path& folder, int count = 3) {
  return WriteShards<SeriesWriter>(folder, FullHeader(), count);
}

std::string ReasonOf(const std::vector<fs::path>& files, const fs::path& output,
                     const MergeOptions& options = {}) {
  try {
    MergeSeries(files, output, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(Shards, CoverTheRunWithoutGapOrOverlap) {
  for (const std::int64_t frames : {0, 1, 7, 100}) {
    for (const int count : {1, 3, 8}) {
      std::int64_t next = 0;
      for (int i = 0; i < count; ++i) {
        const SeriesShard shard = ShardOf(i, count, frames);
        EXPECT_EQ(shard.first_frame, next);
        next = EndOf(shard);
        EXPECT_LE(next - shard.first_frame, frames / count + 1);
      }
      EXPECT_EQ(next, frames);
    }
  }
  EXPECT_THROW(ShardOf(3, 3, 10), std::invalid_argument);
  SeriesHeader header = testing::SmallHeader();
  header.shard = SeriesShard{1, 3, 4, 10};  // 3 is the first
  EXPECT_THROW(SeriesWriter(TestFolder() / "run.h5", header), std::invalid_argument);
}

TEST(Merge, ACopyStoresTheBytesOfARunThatWasNotCut) {
  const fs::path folder = TestFolder();
  std::vector<fs::path> files = WriteStereoShards(folder);
  EXPECT_EQ(SeriesReader(files[1]).facts().shard, ShardOf(1, 3, kFrames));
  std::swap(files[0], files[2]);  // the order on the command line does not matter
  const MergedSeries merged = MergeSeries(files, folder / "run.h5", {.copy = true});
  EXPECT_EQ(merged.frames, kFrames);
  EXPECT_EQ(merged.shards, 3);
  testing::ExpectSameStoredBytes(folder / "whole.h5", folder / "run.h5", 200, 390);
  for (const fs::path& file : files) fs::remove(file);
  EXPECT_THAT(Validate(folder / "run.h5"), IsEmpty());
  const SeriesReader reader(folder / "run.h5");
  EXPECT_FALSE(reader.facts().shard);
  ASSERT_EQ(reader.frame_count(), kFrames);
  for (std::int64_t i = 0; i < kFrames; ++i) {
    testing::ExpectSameFrame(FrameOf(i, FullHeader()), reader.Frame(i));
  }
}

TEST(Merge, VirtualDatasetsReadLikeARunThatWasNotCut) {
  const fs::path folder = TestFolder();
  const fs::path file = folder / "run.h5";
  MergeSeries(WriteStereoShards(folder), file);
  EXPECT_THAT(Validate(file), IsEmpty());
  EXPECT_EQ(Inspect(file).frames, kFrames);
  const SeriesReader reader(file);
  ASSERT_EQ(reader.frame_count(), kFrames);
  for (std::int64_t i = 0; i < kFrames; ++i) {
    testing::ExpectSameFrame(FrameOf(i, FullHeader()), reader.Frame(i));
  }
  testing::WalkWithH5py(file, R"py(
whole = h5py.File(sys.argv[1].replace('run.h5', 'whole.h5'), 'r')
check_nexus('surface', 'grid', 'frames', 'ground', 'displacement', 'strain', 'wheel', 'patch', 'slip', 'channels/Fz')
assert count > 200, count
virtual = 0
def same(name, o):
    global virtual
    assert {k for k in o.attrs} == {k for k in f[name].attrs}, name
    if not isinstance(o, h5py.Dataset): return
    a, b = o[()], f[name][()]
    assert o.dtype == f[name].dtype and o.shape == f[name].shape, name
    assert (list(np.ravel(a)) == list(np.ravel(b))) if o.dtype == object else a.tobytes() == b.tobytes(), name
    virtual += f[name].is_virtual
whole.visititems(same)
assert virtual > 40, virtual
assert f['strain/green_lagrange'] == f['strain/value']
s = f['sources']
assert list(s['name'].asstr()) == ['shard0.h5', 'shard1.h5', 'shard2.h5'] and list(s['frames']) == [3, 3, 4]
import hashlib, os
for k in range(3):
    data = open(os.path.join(os.path.dirname(sys.argv[1]), s['name'].asstr()[k]), 'rb').read()
    assert len(data) == s['size'][k] and hashlib.sha256(data).hexdigest() == s['sha256'].asstr()[k]
print('walked')
)py");
}

TEST(Merge, OfOneCameraToo) {
  const fs::path folder = TestFolder();
  const PlanarSeriesHeader header = testing::PlanarHeader({300, 101});  // two bands a frame
  const auto files = WriteShards<PlanarSeriesWriter>(folder, header, 4);
  MergeSeries(files, folder / "copy.h5", {.copy = true});
  testing::ExpectSameStoredBytes(folder / "whole.h5", folder / "copy.h5", 30, 200);
  MergeSeries(files, folder / "run.h5");
  EXPECT_THAT(Validate(folder / "run.h5"), IsEmpty());
  const PlanarSeriesReader reader(folder / "run.h5");
  ASSERT_EQ(reader.frame_count(), kFrames);
  for (std::int64_t i = 0; i < kFrames; ++i) {
    testing::ExpectSamePlanarFrame(FrameOf(i, header), reader.Frame(i));
  }
}

TEST(Merge, ReadersRefuseAShardThatIsMissingOrHasChanged) {
  const fs::path folder = TestFolder();
  const fs::path file = folder / "run.h5";
  const auto files = WriteStereoShards(folder);
  MergeSeries(files, file);
  const auto expect_refused = [&](const char* reason) {
    try {
      SeriesReader reader(file);
      ADD_FAILURE() << reason;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(reason));
    }
    EXPECT_THAT(Validate(file), ::testing::ElementsAre(HasSubstr(reason)));
  };
  // One bit of the values, where only the hash can tell.
  const auto place = testing::RunPython(
      "import sys, h5py\n"
      "with h5py.File(sys.argv[1], 'r') as f:\n"
      "    print(f['surface/correlation'].id.get_chunk_info(1).byte_offset + 9, end='')\n",
      files[1].string());
  const std::streamoff at = std::stol(place.output);
  std::fstream bytes(files[1], std::ios::in | std::ios::out | std::ios::binary);
  bytes.seekg(at);
  const char old = static_cast<char>(bytes.get());
  const auto put = [&](char byte) {
    bytes.seekp(at);
    bytes.put(byte).flush();
  };
  put(static_cast<char>(old ^ 1));
  EXPECT_NO_THROW(SeriesReader{file});
  EXPECT_THAT(Validate(file),
              ::testing::ElementsAre(HasSubstr("shard1.h5 has changed since they were joined")));
  put(old);
  EXPECT_THAT(Validate(file), IsEmpty());
  const auto size = fs::file_size(files[2]);
  fs::resize_file(files[2], size + 1);
  expect_refused("shard2.h5 has");
  fs::resize_file(files[2], size);
  fs::rename(files[0], folder / "other.h5");
  expect_refused("shard0.h5 is missing");
  fs::rename(folder / "other.h5", files[0]);
  // All of it may move together.
  fs::create_directory(folder / "moved");
  for (const auto& part : files) fs::rename(part, folder / "moved" / part.filename());
  fs::rename(file, folder / "moved/run.h5");
  EXPECT_THAT(Validate(folder / "moved/run.h5"), IsEmpty());
}

TEST(Merge, AFileMayOnlyPointIntoItsOwnFolder) {
  const fs::path folder = TestFolder() / "in";
  fs::create_directory(folder);
  MergeSeries(WriteStereoShards(folder), folder / "run.h5");
  fs::copy_file(folder / "shard1.h5", TestFolder() / "outside.h5");
  const auto made = testing::RunPython(R"py(
import sys, os, shutil, h5py
folder = sys.argv[1]
def point(name, source):
    shutil.copy(folder + '/run.h5', folder + '/' + name)
    with h5py.File(folder + '/' + name, 'r+') as f:
        layout = h5py.VirtualLayout((1, 5, 7), 'f4')
        layout[:] = h5py.VirtualSource(source, 'surface/correlation', (1, 5, 7))
        f.create_virtual_dataset('v', layout)
point('upward.h5', '../outside.h5')
point('absolute.h5', os.path.abspath(folder + '/../outside.h5'))
os.symlink('../outside.h5', folder + '/link.h5')
point('linked.h5', 'link.h5')
point('nested.h5', 'run.h5')
point('absent.h5', 'nowhere.h5')
shutil.copy(folder + '/shard1.h5', folder + '/bad_shard.h5')
with h5py.File(folder + '/bad_shard.h5', 'r+') as f:
    f.create_dataset('x', (1,), 'f8', external=[('/etc/passwd', 0, 8)])
point('external.h5', 'bad_shard.h5')
point('good.h5', 'shard1.h5')
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_NO_THROW(SeriesReader{folder / "good.h5"});
  for (const char* name : {"upward", "absolute", "linked", "nested", "absent", "external"}) {
    EXPECT_THROW(SeriesReader{folder / (std::string(name) + ".h5")}, InputError) << name;
  }
}

TEST(Merge, RefusesWhatIsNotOneWholeRun) {
  const fs::path folder = TestFolder();
  const fs::path output = folder / "run.h5";
  const auto files = WriteStereoShards(folder);
  const auto shard_with = [&](const char* name, int i, const auto& change) {
    SeriesHeader header = FullHeader();
    header.shard = ShardOf(i, 3, kFrames);
    std::int64_t first = header.shard->first_frame, end = EndOf(*header.shard);
    change(header, first, end);
    WriteRange<SeriesWriter>(folder / name, header, first, end);
    return folder / name;
  };
  EXPECT_THAT(ReasonOf({}, output), HasSubstr("no shards"));
  EXPECT_THAT(ReasonOf({files[0], folder / "none.h5"}, output), HasSubstr("none.h5"));
  EXPECT_THAT(ReasonOf({folder / "whole.h5"}, output), HasSubstr("whole.h5 is no shard"));
  EXPECT_THAT(ReasonOf({files[1]}, output), HasSubstr("missing: 1, 3"));
  EXPECT_THAT(ReasonOf({files[0], files[1], files[1], files[2]}, output),
              HasSubstr("shard1.h5 both are shard 2 of 3"));
  EXPECT_THAT(ReasonOf(files, files[0]), HasSubstr("shard0.h5 is a shard and the output too"));
  const fs::path few = shard_with("few.h5", 1, [](auto&, auto&, std::int64_t& end) { --end; });
  EXPECT_THAT(ReasonOf({files[0], few, files[2]}, output),
              HasSubstr("few.h5 holds 2 frames, and 3 are its part"));
  const fs::path twice =
      shard_with("twice.h5", 1, [](auto&, std::int64_t& first, std::int64_t& end) {
        --first;
        --end;
      });
  EXPECT_THAT(ReasonOf({files[0], twice, files[2]}, output),
              HasSubstr("twice.h5 holds the frame 12 behind the frame 12 of"));
  const auto differs = [&](const char* name, const auto& change) {
    const fs::path other =
        shard_with(name, 1, [&](SeriesHeader& header, auto&, auto&) { change(header); });
    return ReasonOf({files[0], other, files[2]}, output);
  };
  EXPECT_THAT(differs("recipe.h5", [](SeriesHeader& h) { h.recipe_toml = "step = 5\n"; }),
              HasSubstr("recipe.h5 are not of the same run: they differ in the recipe"));
  EXPECT_THAT(
      differs("rig.h5", [](SeriesHeader& h) { h.rig.right_from_left.translation_mm.x() += 1; }),
      HasSubstr("they differ in /rig/"));
  EXPECT_THAT(differs("grid.h5", [](SeriesHeader& h) { h.grid_px(1, 1).x() += 1; }),
              HasSubstr("they differ in /grid/pixel"));
  EXPECT_THAT(differs("contents.h5", [](SeriesHeader& h) { h.contents.wheel = false; }),
              HasSubstr("they differ in /wheel"));
  std::ofstream(folder / "in.txt") << "abc";
  EXPECT_THAT(differs("inputs.h5", [&](SeriesHeader& h) { h.inputs = {folder / "in.txt"}; }),
              HasSubstr("they differ in the attribute inputs"));
  EXPECT_EQ(differs("threads.h5", [](SeriesHeader& h) { h.recipe_toml = "threads = 9\n"; }), "");
  fs::remove(output);
  const auto damaged = testing::RunPython(
      "import sys, h5py\n"
      "with h5py.File(sys.argv[1], 'r+') as f: f['surface/position'][0, 0, 0] = float('nan')\n",
      (folder / "threads.h5").string());
  EXPECT_EQ(damaged.exit_code, 0);
  EXPECT_THAT(ReasonOf({files[0], folder / "threads.h5", files[2]}, output),
              HasSubstr("threads.h5 cannot be merged, it is not whole: frame 0: 1 points"));
  EXPECT_FALSE(fs::exists(output));
}

TEST(Merge, ShardsElsewhereAreCopiedOrRefused) {
  const fs::path folder = TestFolder();
  const auto files = WriteStereoShards(folder);
  fs::create_directory(folder / "below");
  EXPECT_THAT(ReasonOf(files, folder / "below/run.h5"), HasSubstr("(--copy)"));
  EXPECT_EQ(ReasonOf(files, folder / "below/run.h5", {.copy = true}), "");
  testing::ExpectSameStoredBytes(folder / "whole.h5", folder / "below/run.h5", 200, 390);
  std::vector<fs::path> moved;
  for (const fs::path& file : files) {
    moved.push_back(folder / "below" / file.filename());
    fs::rename(file, moved.back());
  }
  EXPECT_EQ(ReasonOf(moved, folder / "run.h5"), "");
  EXPECT_THAT(Validate(folder / "run.h5"), IsEmpty());
}

TEST(Merge, LeavesNothingBehindWhenItIsStoppedOrTheDiskIsFull) {
  const fs::path folder = TestFolder();
  const auto files = WriteStereoShards(folder);
  for (const int steps : {0, 2, 5}) {
    int seen = -1;
    const MergedSeries merged = MergeSeries(files, folder / "run.h5",
                                            {.copy = true,
                                             .progress = [&](int done, int) { seen = done; },
                                             .stop = [&] { return seen + 1 >= steps; }});
    EXPECT_TRUE(merged.stopped);
    EXPECT_EQ(seen, steps - 1);
  }
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  signal(SIGXFSZ, SIG_IGN);
  rlimit small = before;
  small.rlim_cur = 8192;
  setrlimit(RLIMIT_FSIZE, &small);
  for (const bool copy : {true, false}) {
    EXPECT_THROW(MergeSeries(files, folder / "run.h5", {.copy = copy}), EnvironmentError);
  }
  setrlimit(RLIMIT_FSIZE, &before);
  for (const auto& entry : fs::directory_iterator(folder)) {
    EXPECT_THAT(entry.path().filename().string(), ::testing::Not(HasSubstr("run.h5")));
  }
  EXPECT_THROW(MergeSeries(files, "/nowhere/run.h5"), EnvironmentError);
}

TEST(Merge, NamesTheFrameOfPositionsOfAllShards) {
  const fs::path folder = TestFolder();
  std::vector<fs::path> files;
  SeriesHeader header = FullHeader();
  for (int i = 0; i < 2; ++i) {
    header.shard = ShardOf(i, 2, 2);
    files.push_back(folder / ("shard" + std::to_string(i) + ".h5"));
    SeriesFrame frame = FullFrame(i);
    frame.surface.frame = i == 0 ? SurfaceFrame::kRig : SurfaceFrame::kGround;
    SeriesWriter writer(files.back(), header);
    writer.Commit(frame);
    writer.Close();
  }
  MergeSeries(files, folder / "run.h5");
  testing::WalkWithH5py(folder / "run.h5", R"py(
for g in ('surface', 'surface/position', 'velocity/value', 'rigid_motion'):
    assert f[g].attrs['frame'] == 'mixed: see /frames/surface_frame', g
print('walked')
)py");
}

}  // namespace
}  // namespace plumbline
