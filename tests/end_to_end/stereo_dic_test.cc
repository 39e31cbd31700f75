// Stereo-DIC as a user runs it: on the virtual rig, through kills, shards and bad input.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "tests/end_to_end/stereo_dic_runs.h"
#include "tests/support/plumbline_json.h"

namespace plumbline {
namespace {

using testing::CommandResult;
using testing::ExpectSameData;
using ::testing::HasSubstr;
using testing::RunJson;
using testing::RunPlumbline;
using testing::RunPython;
using testing::TestFolder;
namespace fs = std::filesystem;

constexpr int kFrames = 8;

// A recording of a sheet that is stretched by 2 % along x; made once for all tests of the process.
const fs::path& Recording() {
  static const fs::path folder =
      testing::RecordStretch("plumbline-dic", kFrames, "--image-size 400x320");
  return folder;
}

std::string Inputs(const fs::path& recording = Recording()) {
  return " --rig " + (Recording() / "rig.h5").string() + " --left '" +
         (recording / "left" / "*.png").string() + "' --right '" +
         (recording / "right" / "*.png").string() + "'";
}

std::string Measure(const fs::path& output, const std::string& more = "") {
  return "measure --matcher dic --step 16 --subset 29 --strain-window 5 --block-frames 3 --fps 10 "
         "-q" +
         Inputs() + " -o " + output.string() + " " + more;
}

TEST(StereoDic, MeasuresMotionAndStrainOverTime) {
  const fs::path run = TestFolder() / "run.h5";
  const auto json = RunJson(Measure(run));
  ASSERT_EQ(json["frames_measured"], kFrames);
  const auto& last = json["frames"][kFrames - 1]["motion"];
  // 2 % along x at the end; Green-Lagrange e + e^2 / 2, and -0.6 % across.
  EXPECT_NEAR(last["strain"][0].get<double>(), 0.0202, 1e-4);
  EXPECT_NEAR(last["strain"][1].get<double>(), -0.005982, 1e-4);
  EXPECT_GT(last["sigma_random_strain"][0].get<double>(), 1e-6);
  EXPECT_FALSE(last["rig_moved"]);
  for (const auto& frame : json["frames"]) EXPECT_GT(frame["valid_points"].get<int>(), 100);
  EXPECT_EQ(RunPlumbline("validate -q " + run.string()).exit_code, 0);

  // The sheet is stretched at a constant rate: velocities grow along x, and are those
  // displacements.
  const CommandResult python = RunPython(
      "import sys, h5py, numpy as np\n"
      "f = h5py.File(sys.argv[1])\n"
      "d, v = f['displacement/value'][:], f['velocity/value'][:]\n"
      "assert np.isnan(v[0]).all()\n"
      "assert np.nanmax(abs(v[3] - (d[3] - d[2]) * 10)) < 1e-3\n"
      "assert f['rigid_motion/rotation'].shape == (8, 3)\n"
      "assert not np.any(f['rig_watch/alarm'][:])\n"
      "e, s = f['strain/green_lagrange'][-1], f['strain/green_lagrange_errors_random'][-1]\n"
      "z = (e[..., 0] - 0.0202) / s[..., 0]\n"
      "print('z', np.sqrt(np.nanmean(z ** 2)) < 1.5)\n",
      run.string());
  EXPECT_THAT(python.output, HasSubstr("z True"));
}

TEST(StereoDic, IsEvaluatedAgainFromItsMatches) {
  const fs::path run = TestFolder() / "run.h5", same = TestFolder() / "same.h5",
                 other = TestFolder() / "other.h5";
  const auto measured = RunJson(Measure(run));
  const auto again =
      RunJson("analyse -q " + run.string() + " -o " + same.string() + " --strain-window 5");
  const auto wide = RunJson("analyse -q " + run.string() + " -o " + other.string() +
                            " --strain-window 7 --strain-measure hencky --frame rig");
  for (int k = 0; k < 3; ++k) {
    const auto of = [&](const nlohmann::json& json, const char* what) {
      return json["frames"][kFrames - 1]["motion"][what][k].get<double>();
    };
    EXPECT_NEAR(of(again, "displacement_mm"), of(measured, "displacement_mm"), 2e-6);
    EXPECT_NEAR(of(again, "strain"), of(measured, "strain"), 2e-7);
    EXPECT_NEAR(of(again, "sigma_random_strain"), of(measured, "sigma_random_strain"), 1e-7);
    EXPECT_LT(of(wide, "sigma_random_strain"), of(measured, "sigma_random_strain"));
  }
  EXPECT_NEAR(wide["frames"][kFrames - 1]["motion"]["strain"][0].get<double>(), std::log(1.02),
              1e-4);
  EXPECT_EQ(RunPlumbline("validate -q " + other.string()).exit_code, 0);
  const CommandResult refused = RunPlumbline("analyse -q " + run.string() + " -o " +
                                             other.string() + " --overwrite --strain-window 1");
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.output, HasSubstr("between 3 and 255 points"));
}

TEST(StereoDic, KeepsTheChannelsOfALogger) {
  const fs::path run = TestFolder() / "run.h5", again = TestFolder() / "again.h5",
                 table = TestFolder() / "channels.csv";
  std::ofstream(table) << "time_s,force_x_N,v [m/s]\n5.0,1,2\n5.1,,3\n";
  RunJson(Measure(run, "--frames 0:2 --channels " + table.string() + " --channel-offset 4.9"));
  RunJson("analyse -q " + run.string() + " -o " + again.string());
  for (const fs::path& file : {run, again}) {
    const CommandResult python = RunPython(
        "import sys, h5py, numpy as np\n"
        "f = h5py.File(sys.argv[1])['channels']\n"
        "assert sorted(f) == ['force_x', 'v'], list(f)\n"
        "x = f['force_x']\n"
        "assert (x['time_s'][:] == [5.0, 5.1]).all() and x['value'].attrs['units'] == 'N'\n"
        "assert x['value'][0] == 1 and np.isnan(x['value'][1])\n"
        "assert x.attrs['clock_offset_s'] == 4.9 and np.isnan(x.attrs['sigma_clock_offset_s'])\n"
        "print('kept')\n",
        file.string());
    EXPECT_THAT(python.output, HasSubstr("kept"));
  }
  std::ofstream(table) << "time_s,v\n5.0,fast\n";
  const CommandResult refused =
      RunPlumbline(Measure(run, "--overwrite --channels " + table.string()));
  EXPECT_EQ(refused.exit_code, 3);
  EXPECT_THAT(refused.output, HasSubstr("line 2, column v: \"fast\" is no number"));
}

TEST(StereoDic, IsEvaluatedAgainWhereTheReferenceIsNoneOfItsFrames) {
  const fs::path late = TestFolder() / "late.h5", again = TestFolder() / "again.h5";
  const auto measured = RunJson(Measure(late, "--reference-frame 0 --frames 4:6"));
  const auto analysed = RunJson("analyse -q " + late.string() + " -o " + again.string() +
                                " --strain-window 5 --strain-weights inverse-variance");
  ASSERT_EQ(analysed["frames"].size(), 2U);
  EXPECT_FALSE(analysed.contains("notes")) << analysed["notes"];  // the image is found again
  for (std::size_t i = 0; i < 2; ++i) {
    const auto expected = measured["frames"][i]["motion"], found = analysed["frames"][i]["motion"];
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(found["displacement_mm"][k].get<double>(),
                  expected["displacement_mm"][k].get<double>(), 2e-6);
      const double sigma = expected["sigma_random_strain"][k].get<double>();
      EXPECT_NEAR(found["strain"][k].get<double>(), expected["strain"][k].get<double>(), sigma);
      // Other weights are other gauges.
      EXPECT_NE(found["strain"][k].get<double>(), expected["strain"][k].get<double>());
      EXPECT_LT(found["sigma_random_strain"][k].get<double>(), 1.001 * sigma);
    }
  }
  EXPECT_EQ(RunPlumbline("validate -q " + late.string()).exit_code, 0);
  EXPECT_EQ(RunPlumbline("validate -q " + again.string()).exit_code, 0);
  EXPECT_EQ(
      RunPlumbline("analyse -q " + again.string() + " -o " + (TestFolder() / "thrice.h5").string())
          .exit_code,
      0);
}

TEST(StereoDic, InShardsIsTheSameAsInOne) {
  const fs::path folder = TestFolder();
  const fs::path whole = folder / "whole.h5";
  ASSERT_EQ(RunPlumbline(Measure(whole)).exit_code, 0);
  std::string shards;
  for (int i = 1; i <= 2; ++i) {
    const fs::path shard = folder / ("shard" + std::to_string(i) + ".h5");
    const CommandResult result =
        RunPlumbline(Measure(shard, "--shard " + std::to_string(i) + "/2"));
    ASSERT_EQ(result.exit_code, 0) << result.output;
    shards += " " + shard.string();
  }
  const fs::path merged = folder / "merged.h5", copied = folder / "copied.h5";
  ASSERT_EQ(RunPlumbline("merge -q" + shards + " -o " + merged.string()).exit_code, 0);
  ASSERT_EQ(RunPlumbline("merge -q --copy" + shards + " -o " + copied.string()).exit_code, 0);
  ExpectSameData(whole, merged);
  ExpectSameData(whole, copied);
  // A finished shard is left as it is.
  const CommandResult again =
      RunPlumbline(Measure(folder / "shard1.h5", "--shard 1/2 --resume 2>&1"));
  EXPECT_EQ(again.exit_code, 0) << again.output;
}

// Starts plumbline with these arguments.
pid_t Start(const std::string& arguments) {
  const pid_t child = fork();
  if (child != 0) return child;
  const std::string line =
      "exec " + std::string(PLUMBLINE_BINARY_DIR) + "/plumbline " + arguments + " >/dev/null 2>&1";
  execl("/bin/sh", "sh", "-c", line.c_str(), nullptr);
  _exit(127);
}

// Kills a run so many times at random moments, going on with it each time; where it ends in
// between, it is begun again. The last one is left to its end.
void KillAndGoOn(int kills, const fs::path& output) {
  std::mt19937 random(7);
  for (int i = 0; i < kills; ++i) {
    const pid_t child = Start(Measure(output, "--resume"));
    usleep(static_cast<useconds_t>(50'000 + random() % 3'000'000));
    const bool ended = waitpid(child, nullptr, WNOHANG) != 0;
    if (!ended) {
      kill(child, SIGKILL);
      waitpid(child, nullptr, 0);
    } else if (i + 1 < kills) {
      fs::remove(output);
    }
  }
  const CommandResult result = RunPlumbline(Measure(output, "--resume"));
  ASSERT_EQ(result.exit_code, 0) << result.output;
}

TEST(StereoDic, KilledAndGoneOnWithIsTheSameAsUndisturbed) {
  const fs::path undisturbed = TestFolder() / "undisturbed.h5", killed = TestFolder() / "killed.h5";
  ASSERT_EQ(RunPlumbline(Measure(undisturbed)).exit_code, 0);
  KillAndGoOn(5, killed);
  ExpectSameData(undisturbed, killed);
  EXPECT_FALSE(fs::exists(killed.string() + ".parts"));
}

TEST(ProveStereoDic, TwoHundredKills) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run this";
  const fs::path undisturbed = TestFolder() / "undisturbed.h5", killed = TestFolder() / "killed.h5";
  ASSERT_EQ(RunPlumbline(Measure(undisturbed)).exit_code, 0);
  KillAndGoOn(200, killed);
  ExpectSameData(undisturbed, killed);
}

TEST(StereoDic, IsGoneOnWithAfterCtrlC) {
  const fs::path whole = TestFolder() / "whole.h5", stopped = TestFolder() / "stopped.h5";
  ASSERT_EQ(RunPlumbline(Measure(whole)).exit_code, 0);
  const pid_t child = Start(Measure(stopped));
  const fs::path journal = stopped.string() + ".parts/journal";
  for (int i = 0; i < 2000; ++i) {
    std::error_code ignored;
    if (fs::exists(journal) && fs::file_size(journal, ignored) > 30'000) break;
    usleep(5000);
  }
  kill(child, SIGINT);
  int status = 0;
  waitpid(child, &status, 0);
  if (WEXITSTATUS(status) == 0) GTEST_SKIP() << "it had ended before it could be stopped";
  EXPECT_EQ(WEXITSTATUS(status), 130);
  ASSERT_EQ(RunPlumbline(Measure(stopped, "--resume")).exit_code, 0);
  ExpectSameData(whole, stopped);
}

// A copy of the recording with something done to one of its images.
fs::path Spoiled(const std::string& python) {
  const fs::path copy = TestFolder() / "spoiled";
  fs::create_directories(copy);
  for (const char* side : {"left", "right"}) {
    fs::copy(Recording() / side, copy / side, fs::copy_options::recursive);
  }
  const CommandResult result = RunPython(
      "import sys, cv2, numpy as np, glob\n"
      "left = sorted(glob.glob(sys.argv[1] + '/left/*.png'))\n"
      "right = sorted(glob.glob(sys.argv[1] + '/right/*.png'))\n" +
          python,
      copy.string());
  EXPECT_EQ(result.exit_code, 0) << result.output;
  return copy;
}

std::string MeasureThese(const fs::path& recording, const fs::path& output) {
  return "measure --matcher dic --step 16 --subset 29 --strain-window 5" + Inputs(recording) +
         " -o " + output.string();
}

TEST(StereoDic, MarksBadFramesAndGoesOn) {
  const fs::path recording = Spoiled(
      "image = cv2.imread(left[2], 0)\n"
      "cv2.imwrite(left[2], image[:200])\n"
      "for side in (left, right):\n"
      "    cv2.imwrite(side[4], np.full_like(cv2.imread(side[4], 0), 90))\n"
      "open(right[5], 'r+b').truncate(2000)\n");
  const auto json = RunJson(MeasureThese(recording, TestFolder() / "run.h5"));
  ASSERT_EQ(json["frames_read"], kFrames);
  EXPECT_EQ(json["frames_measured"], kFrames - 3);
  EXPECT_THAT(json["frames"][2]["problem"].get<std::string>(), HasSubstr("400x200"));
  EXPECT_THAT(json["frames"][4]["problem"].get<std::string>(), HasSubstr("found again"));
  EXPECT_THAT(json["frames"][5]["problem"].get<std::string>(), HasSubstr("00005.png"));
  EXPECT_NEAR(json["frames"][kFrames - 1]["motion"]["strain"][0].get<double>(), 0.0202, 1e-4);
}

TEST(StereoDic, RefusesWhatCannotBe) {
  fs::remove(TestFolder() / "run.h5");
  const std::string out = " -o " + (TestFolder() / "run.h5").string();
  const std::string rig = " --rig " + (Recording() / "rig.h5").string();
  const std::string left = "'" + (Recording() / "left" / "*.png").string() + "'",
                    right = "'" + (Recording() / "right" / "*.png").string() + "'";
  const std::string dic = "measure --matcher dic --step 16 --subset 29";
  const auto expect = [](const std::string& arguments, int code, const std::string& part) {
    const CommandResult result = RunPlumbline(arguments + " -q");
    EXPECT_EQ(result.exit_code, code) << result.output;
    EXPECT_THAT(result.output, HasSubstr(part));
  };
  expect(dic + rig + " --left " + right + " --right " + left + out, 3, "swapped");
  expect(Measure(TestFolder() / "run.h5", "--shard 5/4"), 2, "1/4 to 4/4");
  expect(Measure(TestFolder() / "run.h5", "--shard 1/7"), 3, "fewer shards");
  expect(Measure("/proc/nowhere/run.h5"), 4, "/proc/nowhere");
  expect(dic + rig + " --left " + left + " --right " + right + out + " --strain-window 1", 2,
         "3 to 255");
  expect(dic + rig + " --left " + left + " --right " + right + out + " --strain-axes up", 2,
         "direction x,y,z");
  EXPECT_FALSE(fs::exists(TestFolder() / "run.h5"));
  EXPECT_FALSE(fs::exists(TestFolder() / "run.h5.parts"));
}

}  // namespace
}  // namespace plumbline
