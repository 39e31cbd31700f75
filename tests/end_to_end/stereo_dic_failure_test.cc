// Stereo-DIC on bad days, as a user meets them: a disk that becomes full, a video that was cut off.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tests/end_to_end/stereo_dic_runs.h"
#include "tests/support/plumbline_json.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;
using testing::CommandResult;
using testing::ExpectSameData;
using ::testing::HasSubstr;
using testing::RunJson;
using testing::RunPlumbline;
using testing::TestFolder;

constexpr int kFrames = 6;

// As videos; made once for all tests of the process.
const fs::path& Recording() {
  static const fs::path folder = testing::RecordStretch("plumbline-dic-failures", kFrames,
                                                        "--image-size 320x256 --images avi");
  return folder;
}

std::string Measure(const fs::path& videos, const fs::path& output, const std::string& more = "") {
  return "measure --matcher dic --step 12 --subset 29 --strain-window 5 --rig " +
         (Recording() / "rig.h5").string() + " --left " + (videos / "left.avi").string() +
         " --right " + (videos / "right.avi").string() + " -o " + output.string() + " " + more;
}

// Runs plumbline where no file can grow beyond so many bytes, as on a disk that becomes full.
CommandResult RunWithRoomFor(std::uintmax_t bytes, const std::string& arguments) {
  return testing::RunCommand("(trap '' XFSZ; ulimit -f " + std::to_string(bytes / 512) + "; exec " +
                             std::string(PLUMBLINE_BINARY_DIR) + "/plumbline " + arguments +
                             " 2>&1)");
}

TEST(StereoDicOnAFullDisk, NamesItAndIsGoneOnWith) {
  const fs::path whole = TestFolder() / "whole.h5", run = TestFolder() / "run.h5",
                 recovered = TestFolder() / "recovered.h5";
  ASSERT_EQ(RunPlumbline(Measure(Recording(), whole, "-q")).exit_code, 0);
  const CommandResult full = RunWithRoomFor(fs::file_size(whole) / 2, Measure(Recording(), run));
  EXPECT_EQ(full.exit_code, 4) << full.output;
  EXPECT_THAT(full.output, HasSubstr((run.string() + ".parts/journal")));
  EXPECT_THAT(full.output, HasSubstr("--resume"));
  EXPECT_THAT(full.output, HasSubstr("plumbline recover"));
  EXPECT_FALSE(fs::exists(run));

  // A file of what is there, made from a copy, and the rest of the run.
  fs::copy(run.string() + ".parts", recovered.string() + ".parts");
  const auto kept = RunJson("recover -q " + recovered.string());
  const int frames = kept["frames"].get<int>();
  EXPECT_GT(frames, 0);
  EXPECT_LT(frames, kFrames);
  EXPECT_EQ(RunPlumbline("validate -q " + recovered.string()).exit_code, 0);
  ASSERT_EQ(RunPlumbline(Measure(Recording(), run, "-q --resume")).exit_code, 0);
  ExpectSameData(whole, run);
}

// A copy of the recording with the end of one video cut off, amid a frame.
fs::path CutOff(const char* video, double share) {
  const fs::path copy = TestFolder() / "videos";
  fs::create_directories(copy);
  for (const char* name : {"left.avi", "right.avi"}) fs::copy(Recording() / name, copy / name);
  fs::resize_file(copy / video, static_cast<std::uintmax_t>(
                                    share * static_cast<double>(fs::file_size(copy / video))));
  return copy;
}

TEST(StereoDicOfAVideo, IsAnalysedWithTheReferenceImageOutOfIt) {
  const fs::path run = TestFolder() / "run.h5";
  ASSERT_EQ(RunPlumbline(Measure(Recording(), run, "-q --frames 0:2")).exit_code, 0);
  const auto again =
      RunJson("analyse -q " + run.string() + " -o " + (TestFolder() / "again.h5").string());
  EXPECT_FALSE(again.contains("notes")) << again["notes"];
}

TEST(StereoDicOfACutOffVideo, MeasuresWhatIsThereAndSaysWhereItEnds) {
  const fs::path whole = TestFolder() / "whole.h5", run = TestFolder() / "run.h5";
  const fs::path videos = CutOff("right.avi", 0.62);
  const auto all = RunJson(Measure(Recording(), whole));
  const CommandResult said = RunPlumbline(Measure(videos, run, "2>&1"));
  EXPECT_EQ(said.exit_code, 0) << said.output;
  const auto cut = RunJson(Measure(videos, run, "--overwrite"));
  const int frames = cut["frames_measured"].get<int>();
  EXPECT_GT(frames, 1);
  EXPECT_LT(frames, kFrames);
  EXPECT_EQ(cut["frames_declared"], kFrames);
  for (int i = 0; i < frames; ++i) {
    EXPECT_EQ(cut["frames"][i]["valid_points"], all["frames"][i]["valid_points"]) << i;
  }
  EXPECT_THAT(said.output, HasSubstr("right.avi"));
  EXPECT_THAT(said.output,
              HasSubstr(std::to_string(frames) + " of " + std::to_string(kFrames) + " frames"));
  EXPECT_EQ(RunPlumbline("validate -q " + run.string()).exit_code, 0);
}

}  // namespace
}  // namespace plumbline
