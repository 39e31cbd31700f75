// Runs that were broken off and are gone on with.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <random>

#include "calib/error.h"
#include "io/inspect.h"
#include "io/series_reader.h"
#include "io/series_start.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/planar_fixture.h"
#include "tests/io/series_comparison.h"
#include "tests/io/series_fixture.h"
#include "tests/io/series_processes.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::FullFrame;
using testing::FullHeader;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::SmallFrame;
using testing::SmallHeader;
using testing::TestFolder;

constexpr ImageSize kGrid{40, 30};
constexpr int kFrames = 30;

PlanarSeriesFrame FrameOf(std::int64_t i, const PlanarSeriesHeader& header) {
  return testing::PlanarFrame(i, header);
}
SeriesFrame FrameOf(std::int64_t i, const SeriesHeader& header) {
  return FullFrame(i, header.grid_px.size());
}

// Run by tests below in a process of its own: goes on with what is there, to the end.
template <typename Writer, typename Header>
void GoOnToTheEnd(const Header& header) {
  const char* file = std::getenv("PLUMBLINE_SERIES_CHILD");
  if (file == nullptr) GTEST_SKIP() << "a part of SeriesResume";
  std::ofstream(std::string(file) + ".started") << 'x';
  if (FindRun(file).kind == RunState::Kind::kFinished) {
    EXPECT_THROW(Writer(file, header, SeriesStart::kResume), InputError);  // and tidies up
    return;
  }
  Writer writer(file, header, SeriesStart::kResume, {.every_s = 1e-3, .largest_load = 1});
  for (std::int64_t i = writer.committed(); i < kFrames; ++i) writer.Commit(FrameOf(i, header));
  writer.Close();
}
TEST(SeriesResumeChild, DISABLED_GoesOnToTheEnd) { GoOnToTheEnd<SeriesWriter>(FullHeader(kGrid)); }
TEST(SeriesResumeChild, DISABLED_GoesOnToTheEndOfOneCamera) {
  GoOnToTheEnd<PlanarSeriesWriter>(testing::PlanarHeader(kGrid));
}

// Kills it again and again, at any moment, until one gets to the end. Returns how often.
int KillUntilFinished(const std::string& test, const fs::path& file, std::mt19937* rng) {
  const fs::path started = file.string() + ".started";
  for (int kills = 0;; ++kills) {
    fs::remove(started);
    const pid_t child = testing::StartChild(test, file, kFrames);
    for (int k = 0; k < 5000 && !fs::exists(started); ++k) usleep(1000);
    // The first kills come soon, so that the run does not end before it was broken off.
    usleep(static_cast<useconds_t>((*rng)() % static_cast<unsigned>(30e3 * std::pow(1.4, kills))));
    kill(child, SIGKILL);
    int status = -1;
    waitpid(child, &status, 0);
    if (WIFEXITED(status)) return kills;
  }
}

template <typename Writer, typename Header>
void ExpectSameAsUndisturbed(const std::string& test, const Header& header) {
  const fs::path folder = TestFolder();
  {
    Writer writer(folder / "whole.h5", header);
    for (std::int64_t i = 0; i < kFrames; ++i) writer.Commit(FrameOf(i, header));
    writer.Close();
  }
  std::mt19937 rng(3);
  const fs::path file = folder / "run.h5";
  EXPECT_GE(KillUntilFinished(test, file, &rng), 4);
  const RunState run = FindRun(file);
  EXPECT_EQ(run.kind, RunState::Kind::kFinished);
  EXPECT_EQ(run.frames, kFrames);
  EXPECT_FALSE(fs::exists(file.string() + ".parts"));
  EXPECT_THAT(Validate(file), IsEmpty());
  testing::ExpectSameStoredBytes(folder / "whole.h5", file, 40, 100);
}

TEST(SeriesResume, AfterKillsAtAnyMomentTheFileIsThatOfAnUndisturbedRun) {
  ExpectSameAsUndisturbed<SeriesWriter>("SeriesResumeChild.DISABLED_GoesOnToTheEnd",
                                        FullHeader(kGrid));
}
TEST(SeriesResume, OfOneCameraToo) {
  ExpectSameAsUndisturbed<PlanarSeriesWriter>(
      "SeriesResumeChild.DISABLED_GoesOnToTheEndOfOneCamera", testing::PlanarHeader(kGrid));
}

// Leaves an unfinished run of three frames.
void BreakOff(const fs::path& file, const SeriesHeader& header) {
  SeriesWriter writer(file, header);
  for (int i = 0; i < 3; ++i) writer.Commit(FullFrame(i));
}

// What a kill at any moment leaves of the journal: some first part of it.
TEST(SeriesResume, FromAnyLengthOfTheJournalTheFileIsThatOfAnUndisturbedRun) {
  const fs::path folder = TestFolder();
  BreakOff(folder / "run.h5", FullHeader());
  fs::copy(folder / "run.h5.parts", folder / "whole.h5.parts");
  SeriesWriter(folder / "whole.h5", FullHeader(), SeriesStart::kResume).Close();
  const auto size = fs::file_size(folder / "run.h5.parts/journal");
  std::mt19937 rng(4);
  int went_on = 0;
  for (int round = 0; round < 12; ++round) {
    const fs::path file = folder / ("run" + std::to_string(round) + ".h5");
    fs::copy(folder / "run.h5.parts", file.string() + ".parts");
    fs::resize_file(file.string() + ".parts/journal", round == 0 ? size : rng() % size);
    SeriesWriter writer(file, FullHeader(), SeriesStart::kResume);
    went_on += writer.committed() > 0 ? 1 : 0;
    for (std::int64_t i = writer.committed(); i < 3; ++i) writer.Commit(FullFrame(i));
    writer.Close();
    if (round % 5 == 0) testing::ExpectSameStoredBytes(folder / "whole.h5", file, 40, 100);
    const SeriesReader reader(file);
    for (int i = 0; i < 3; ++i) testing::ExpectSameFrame(FullFrame(i), reader.Frame(i));
  }
  EXPECT_GT(went_on, 4);
}

TEST(SeriesResume, SaysWhatIsThereAndGoesOnBehindIt) {
  const fs::path file = TestFolder() / "run.h5";
  EXPECT_EQ(FindRun(file).kind, RunState::Kind::kNone);
  {
    SeriesWriter writer(file, FullHeader(), SeriesStart::kResume);  // begins
    EXPECT_EQ(writer.committed(), 0);
    EXPECT_FALSE(writer.last_index());
    for (int i = 0; i < 3; ++i) writer.Commit(FullFrame(i));
    EXPECT_TRUE(FindRun(file).being_written);
    try {
      SeriesWriter(file, FullHeader(), SeriesStart::kResume);
      ADD_FAILURE() << "two write one run";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr("is being written by a run that is still going on"));
    }
    writer.Commit(FullFrame(3));
  }
  const RunState run = FindRun(file);
  EXPECT_EQ(run.kind, RunState::Kind::kUnfinished);
  EXPECT_EQ(run.frames, 4);
  EXPECT_EQ(run.last_index, 13);
  EXPECT_EQ(run.recipe_toml, "threads = 2\n");
  EXPECT_FALSE(run.being_written);
  // Half a record, as a kill leaves it.
  std::ofstream(file.string() + ".parts/journal", std::ios::app | std::ios::binary) << "PLBJ half";
  SeriesHeader header = FullHeader();
  header.recipe_toml = "threads = 8\nresume = true\n";
  {
    SeriesWriter writer(file, header, SeriesStart::kResume);
    EXPECT_EQ(writer.committed(), 4);
    EXPECT_EQ(writer.last_index(), 13);
    writer.Commit(FullFrame(4));
    EXPECT_EQ(writer.committed(), 5);
    EXPECT_EQ(writer.last_index(), 14);
    writer.Close();
  }
  const SeriesReader reader(file);
  ASSERT_EQ(reader.frame_count(), 5);
  for (int i = 0; i < 5; ++i) testing::ExpectSameFrame(FullFrame(i), reader.Frame(i));
  EXPECT_EQ(FindRun(file).kind, RunState::Kind::kFinished);
  EXPECT_EQ(FindRun(file).frames, 5);
  try {
    SeriesWriter(file, FullHeader(), SeriesStart::kResume);
    ADD_FAILURE() << "went on with a finished run";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("run.h5 is finished"));
  }
  EXPECT_FALSE(fs::exists(file.string() + ".parts"));
}

TEST(SeriesResume, RefusesAnotherRunNamingWhatDiffers) {
  const fs::path folder = TestFolder();
  const fs::path file = folder / "run.h5";
  std::ofstream(folder / "in0") << "abc";
  std::ofstream(folder / "in1") << "abc";
  SeriesHeader begun = FullHeader();
  begun.recipe_toml = "[measure]\nstep = 4\nthreads = 2\n";
  begun.inputs = {folder / "in0"};
  BreakOff(file, begun);
  struct Case {
    std::function<void(SeriesHeader&)> change;
    const char* named;
  };
  const std::vector<Case> cases = {
      {[](SeriesHeader& h) { h.grid_px(0, 0).x() = 1; }, "/grid/pixel"},
      {[](SeriesHeader& h) {
         h.grid_px = SmallHeader({8, 5}).grid_px;
       },
       "/grid"},
      {[](SeriesHeader& h) { h.step_px = 5; }, "/grid/step_px"},
      {[](SeriesHeader& h) { h.recipe_toml = "[measure]\nstep = 5\n"; }, "the recipe"},
      {[](SeriesHeader& h) { h.contents.wheel = false; }, "its grid or its contents are others"},
      {[](SeriesHeader& h) { h.contents.slip = false; }, "/slip"},
      {[](SeriesHeader& h) { h.strain_measure = "hencky"; }, "the attribute measure of /strain"},
      {[](SeriesHeader& h) { h.rig.right_from_left.translation_mm.x() += 0.1; }, "/rig/"},
      {[](SeriesHeader& h) { h.rig.board = "circles"; }, "the attribute board of /rig"},
      {[](SeriesHeader& h) { h.channels[0].value[1] = 7; }, "/channels/Fz/value"},
      {[&](SeriesHeader& h) { h.inputs = {folder / "in1"}; }, "in1 was "},
      {[&](SeriesHeader& h) { h.inputs.push_back(folder / "in1"); }, "it has 2 inputs and had 1"}};
  for (const Case& one : cases) {
    SeriesHeader header = begun;
    one.change(header);
    try {
      SeriesWriter(file, header, SeriesStart::kResume);
      ADD_FAILURE() << one.named;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(one.named));
      EXPECT_THAT(error.what(), HasSubstr("run.h5.parts cannot be gone on with"));
    }
  }
  std::ofstream(folder / "in0") << "abcd";
  try {
    SeriesWriter(file, begun, SeriesStart::kResume);
    ADD_FAILURE() << "an input has changed";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("in0 has 4 bytes and had 3"));
  }
  std::ofstream(folder / "in0") << "abc";
  SeriesWriter writer(file, begun, SeriesStart::kResume);  // nothing was lost on the way
  EXPECT_EQ(writer.committed(), 3);
  writer.Close();
}

TEST(SeriesResume, BeginsAnewWhereNothingWasCommittedYet) {
  const fs::path file = TestFolder() / "run.h5";
  const fs::path parts = file.string() + ".parts";
  fs::create_directory(parts);
  std::ofstream(parts / "journal") << "PL";  // killed while the first record was written
  EXPECT_EQ(FindRun(file).frames, 0);
  {
    SeriesWriter writer(file, SmallHeader(), SeriesStart::kResume);
    EXPECT_EQ(writer.committed(), 0);
    writer.Commit(SmallFrame(0));
    writer.Close();
  }
  EXPECT_EQ(SeriesReader(file).frame_count(), 1);
  // A run that was killed while it removed its parts: the journal goes first.
  fs::create_directory(parts);
  std::ofstream(parts / "header.h5") << "half gone";
  EXPECT_EQ(FindRun(file).kind, RunState::Kind::kFinished);
  SeriesWriter(file, SmallHeader()).Close();
  EXPECT_EQ(SeriesReader(file).frame_count(), 0);
  // What is not ours stays.
  fs::create_directory(parts);
  std::ofstream(parts / "notes.txt") << "mine";
  EXPECT_THROW(SeriesWriter(file, SmallHeader()), InputError);
  EXPECT_TRUE(fs::exists(parts / "notes.txt"));
}

TEST(SeriesResume, ADamagedJournalIsNeverThrownAway) {
  const fs::path file = TestFolder() / "run.h5";
  BreakOff(file, FullHeader());
  const fs::path journal = file.string() + ".parts/journal";
  const auto size = fs::file_size(journal);
  std::fstream(journal, std::ios::in | std::ios::out | std::ios::binary).put('X');
  EXPECT_THROW(SeriesWriter(file, FullHeader(), SeriesStart::kResume), InputError);
  EXPECT_EQ(fs::file_size(journal), size);
}

TEST(Recipe, OptionsThatChangeNoNumberAreNotOfTheData) {
  EXPECT_EQ(RecipeOfTheData("[measure]\nstep = 4\nthreads = 2\noutput = 'a.h5'\nshard = '1/3'\n"),
            RecipeOfTheData("[measure]\nresume = true\noutput = 'b.h5'\nstep = 4\n"));
  EXPECT_NE(RecipeOfTheData("[measure]\nstep = 4\n"), RecipeOfTheData("[measure]\nstep = 5\n"));
  EXPECT_EQ(RecipeOfTheData("= no TOML"), "= no TOML");
}

}  // namespace
}  // namespace plumbline
