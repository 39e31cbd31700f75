// The virtual rig as a user meets it: simulate, calibrate, measure, compare.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "calib/board.h"
#include "io/image_source.h"
#include "io/inspect.h"
#include "io/rig_file.h"
#include "io/series_reader.h"
#include "io/virtual_rig/scenario.h"
#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::RunPlumbline;

std::string TextOf(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

TEST(Simulate, ListNamesEveryScenarioWithOneLine) {
  const auto list = RunPlumbline("simulate list");
  EXPECT_EQ(list.exit_code, 0);
  for (const ScenarioEntry& entry : ListScenarios()) {
    EXPECT_THAT("\n" + list.output, HasSubstr("\n" + entry.name + " ")) << entry.name;
    EXPECT_THAT(list.output, HasSubstr(entry.summary + "\n"));
  }
}

// The demo's recording on fewer frames, and what its photographs calibrate to; made once for all
// tests of the process.
struct Careful {
  std::string sim, rig;
  testing::CommandResult calibrated;
};

testing::CommandResult Calibrate(const std::string& sim, const std::string& rig) {
  return RunPlumbline("calibrate --json --board charuco:11x8:12mm:9mm:DICT_5X5_100 --left " + sim +
                      "/calibration/left --right " + sim + "/calibration/right -o " + rig +
                      " 2>/dev/null");
}

const Careful& CarefullyHeld() {
  static const Careful made = [] {
    const fs::path folder = fs::path(PLUMBLINE_BINARY_DIR) / "tests" / "simulated-careful";
    fs::remove_all(folder);
    fs::create_directories(folder);
    Careful careful{(folder / "sim").string(), (folder / "rig.h5").string(), {}};
    const auto simulated =
        RunPlumbline("simulate tyre-flat -q --frame-count 2 --calibration 16 -o " + careful.sim);
    EXPECT_EQ(simulated.exit_code, 0) << simulated.output;
    careful.calibrated = Calibrate(careful.sim, careful.rig);
    EXPECT_EQ(careful.calibrated.exit_code, 0) << careful.calibrated.output;
    return careful;
  }();
  return made;
}

// What the demo does: the errors against truth are what they were said to be.
TEST(Simulate, IsCalibratedMeasuredAndComparedLikeARealRecording) {
  const fs::path folder = testing::TestFolder();
  const auto& [sim, rig, calibrated] = CarefullyHeld();
  const auto measured = RunPlumbline("measure -q --rig " + rig + " --left " + sim +
                                     "/left --right " + sim + "/right --timestamps " + sim +
                                     "/timestamps.csv --step 6 -o " + (folder / "run.h5").string());
  ASSERT_EQ(measured.exit_code, 0) << measured.output;
  const auto compared = RunPlumbline("compare --json " + (folder / "run.h5").string() + " " + sim);
  ASSERT_EQ(compared.exit_code, 0) << compared.output;
  const auto json = nlohmann::json::parse(compared.output);
  ASSERT_EQ(json["frames"].size(), 2U);
  for (const auto& frame : json["frames"]) {
    EXPECT_GT(frame["points"], 4000);
    // The sides of the view, steep and blurred, are the worst of it.
    EXPECT_LT(frame["median_height_error_mm"], 0.08);
    EXPECT_LT(frame["rms_distance_mm"], 0.3);
    EXPECT_GT(frame["within_two_sigma"], 0.95);
    for (int k = 0; k < 2; ++k) {
      EXPECT_LT(std::abs(frame["tilt_error_deg"][k].get<double>()),
                4 * frame["sigma_tilt_deg"][k].get<double>());
    }
  }
  const auto people = RunPlumbline("compare " + (folder / "run.h5").string() + " " + sim);
  EXPECT_THAT(people.output, HasSubstr("median"));
}

// The words of every kind of board, each held over a range of distances that suits its size.
TEST(Simulate, EveryKindOfBoardIsPhotographedAndFound) {
  const fs::path folder = testing::TestFolder();
  struct Case {
    const char* word;
    int min_mm, max_mm;
  };
  for (const Case& c : {Case{"chessboard:12x8:5mm", 90, 130}, Case{"acircles:4x11:20mm", 220, 300},
                        Case{"circles:14x10:7mm", 110, 150}, Case{"donut-dots:14x10:7mm", 110, 140},
                        Case{"charuco:5x7:36.2mm:18.3mm:DICT_6X6_250", 250, 350},
                        Case{"aprilgrid:6x6:88mm:0.3:tag36h11", 450, 650}}) {
    for (const char* how : {"", "--careless", "--bend 0.5 --misprint 0.05"}) {
      const std::string sim = (folder / "sim").string();
      const auto simulated = RunPlumbline(
          "simulate still -q --overwrite --cameras wide640 --frame-count 1 --step 60 "
          "--calibration 1 --board " +
          std::string(c.word) + " --min-distance " + std::to_string(c.min_mm) + " --max-distance " +
          std::to_string(c.max_mm) + " " + how + " -o " + sim);
      ASSERT_EQ(simulated.exit_code, 0) << c.word << " " << how << ": " << simulated.output;
      const BoardSpec board = BoardSpec::Parse(c.word);
      const auto source = OpenImageSource(sim + "/calibration/left", sim + "/calibration/right");
      const auto photographs = source->Next();
      ASSERT_TRUE(photographs);
      for (const GrayImage* image : {&photographs->left, &photographs->right}) {
        const BoardDetection found = DetectBoard(board, *image);
        EXPECT_GE(10 * static_cast<int>(found.ids.size()), 6 * board.PointCount())
            << c.word << " " << how << ": " << found.problem;
      }
    }
  }
}

// The points of a board as a table of id, x, y, z.
std::vector<Eigen::Vector3d> PointsOf(const fs::path& csv) {
  std::ifstream in(csv);
  std::string line;
  std::getline(in, line);
  std::vector<Eigen::Vector3d> points;
  double id = 0;
  char comma = 0;
  for (Eigen::Vector3d p; in >> id >> comma >> p.x() >> comma >> p.y() >> comma >> p.z();) {
    points.push_back(p);
  }
  return points;
}

// A bent and misprinted board is calibrated from photographs of it, and found to be what it is.
TEST(Simulate, ABentAndMisprintedBoardIsFoundAsItWasMade) {
  const fs::path folder = testing::TestFolder();
  const std::string sim = (folder / "sim").string(), rig = (folder / "rig.h5").string();
  ASSERT_EQ(RunPlumbline("simulate tyre-flat -q --frame-count 1 --calibration 16 --bend 0.8 "
                         "--misprint 0.08 -o " +
                         sim)
                .exit_code,
            0);
  const auto calibrated = Calibrate(sim, rig);
  ASSERT_EQ(calibrated.exit_code, 0) << calibrated.output;
  const std::vector<Eigen::Vector3d> made = PointsOf(sim + "/calibration/board.csv");
  const NamedArray refined = ReadRigArray(rig, "board/points");
  ASSERT_EQ(made.size(), 70U);
  ASSERT_EQ(refined.values.size(), 210U);
  Eigen::Matrix3Xd truth(3, 70), found(3, 70), nominal(3, 70);
  const BoardSpec board = BoardSpec::Parse("charuco:11x8:12mm:9mm:DICT_5X5_100");
  for (int k = 0; k < 70; ++k) {
    truth.col(k) = made[static_cast<std::size_t>(k)];
    found.col(k) = Eigen::Map<const Eigen::Vector3d>(refined.values.data() + 3 * k);
    nominal.col(k) = board.NominalPoint(k);
  }
  // Up to a rigid motion and the scale, which no photograph shows.
  const auto rms_mm = [&](const Eigen::Matrix3Xd& points) {
    const Eigen::Matrix4d T = Eigen::umeyama(points, truth, true);
    const Eigen::Matrix3Xd moved =
        (T.topLeftCorner<3, 3>() * points).colwise() + T.topRightCorner<3, 1>();
    return std::sqrt((moved - truth).colwise().squaredNorm().mean());
  };
  EXPECT_GT(rms_mm(nominal), 0.15);
  EXPECT_LT(rms_mm(found), 0.03);
}

TEST(Simulate, ACarelesslyHeldBoardCalibratesWorseAndIsToldSo) {
  const fs::path folder = testing::TestFolder();
  const std::string sim = (folder / "careless").string();
  ASSERT_EQ(
      RunPlumbline("simulate tyre-flat -q --frame-count 1 --calibration 16 --careless -o " + sim)
          .exit_code,
      0);
  const auto careful = CarefullyHeld().calibrated;
  const auto careless = Calibrate(sim, (folder / "careless.h5").string());
  ASSERT_EQ(careless.exit_code, 0) << careless.output;
  EXPECT_THAT(careful.output, ::testing::Not(HasSubstr("tilted by at most")));
  EXPECT_THAT(careless.output, HasSubstr("tilted by at most 7 deg"));
  const auto sigma_mm = [](const testing::CommandResult& result) {
    return nlohmann::json::parse(result.output)["sigma_baseline_mm"].get<double>();
  };
  EXPECT_GT(sigma_mm(careless), 4 * sigma_mm(careful));
}

TEST(Simulate, DisturbancesAndLightFollowTheirOptions) {
  const fs::path folder = testing::TestFolder();
  const auto simulate = [&](const std::string& name, const std::string& options) {
    const auto result = RunPlumbline(
        "simulate tyre-disturbed -q --frame-count 1 --start -20 "
        "--step 40 " +
        options + " -o " + (folder / name).string());
    EXPECT_EQ(result.exit_code, 0) << result.output;
    return (folder / name).string();
  };
  const std::string on = simulate("on", ""), off = simulate("off", "--vehicle-pitch off"),
                    bright = simulate("bright", "--brightness 900");
  // Its axle has risen by some millimetres on a wheelbase of 2794 mm.
  const auto ahead = [](const std::string& sim) -> double {
    return SeriesReader(sim + "/truth.h5").Frame(0).ground.ground_from_rig.rotation(2, 0);
  };
  EXPECT_GT(ahead(on) - ahead(off), 1e-3);
  EXPECT_LT(ahead(on) - ahead(off), 1e-2);
  const auto saturated = [](const std::string& sim) {
    const auto frame = OpenImageSource(sim + "/left", sim + "/right")->Next();
    const auto& grey = frame->left.grey.values();
    return static_cast<double>(std::count(grey.begin(), grey.end(), 255)) /
           static_cast<double>(grey.size());
  };
  EXPECT_EQ(saturated(on), 0);
  EXPECT_GT(saturated(bright), 0.3);
}

TEST(Simulate, ARecipeMakesTheSameRecordingAgain) {
  const fs::path folder = testing::TestFolder();
  const std::string first = (folder / "first").string(), second = (folder / "second").string();
  ASSERT_EQ(
      RunPlumbline("simulate nuts -q --frame-count 2 --seed 5 --speed 2 --bits 10 --threads 1 -o " +
                   first)
          .exit_code,
      0);
  ASSERT_EQ(RunPlumbline("simulate -q --recipe " + first + "/recipe.toml --threads 2 -o " + second)
                .exit_code,
            0);
  for (const char* file : {"left/00001.png", "right/00000.png", "channels.csv"}) {
    EXPECT_EQ(TextOf(fs::path(first) / file), TextOf(fs::path(second) / file)) << file;
  }
  EXPECT_TRUE(Validate(fs::path(second) / "truth.h5").empty());
}

// Cameras of any make, from a file; the recording keeps them when that file is gone.
TEST(Simulate, TakesTheCamerasOfARigFile) {
  const fs::path folder = testing::TestFolder();
  const std::string cd = "cd " + folder.string() + " && ";
  const std::string plumbline = std::string(PLUMBLINE_BINARY_DIR) + "/plumbline ";
  const auto run = [&](const std::string& arguments) {
    const auto result = testing::RunCommand(cd + plumbline + arguments);
    EXPECT_EQ(result.exit_code, 0) << arguments << ": " << result.output;
    return result.output;
  };
  run("simulate tyre-flat -q --frame-count 1 --baseline 55 --distance 150 --step 40 -o first");
  fs::rename(folder / "first" / "rig.h5", folder / "cameras.h5");
  run("simulate tyre-flat -q --frame-count 1 --rig cameras.h5 --step 40 -o second");
  for (const char* file : {"left/00000.png", "right/00000.png"}) {
    EXPECT_EQ(TextOf(folder / "first" / file), TextOf(folder / "second" / file)) << file;
  }
  fs::remove(folder / "cameras.h5");
  // The truth held against itself.
  const auto json = nlohmann::json::parse(run("compare --json second/truth.h5 second"));
  EXPECT_GT(json["frames"][0]["points"], 100);
  EXPECT_LT(json["frames"][0]["rms_distance_mm"], 1e-4);
  const auto refused =
      testing::RunCommand(cd + plumbline + "simulate still --rig second/rig.h5 --lens 5 -o third");
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.output, HasSubstr("--rig says all of the cameras"));
}

TEST(Simulate, WritesVideosThatMeasureReads) {
  const fs::path folder = testing::TestFolder();
  const std::string sim = (folder / "sim").string();
  ASSERT_EQ(RunPlumbline("simulate incline -q --frame-count 2 --images mkv -o " + sim).exit_code,
            0);
  const auto measured =
      RunPlumbline("measure --rig " + sim + "/rig.h5 --left " + sim + "/left.mkv --right " + sim +
                   "/right.mkv --step 8 -o " + (folder / "run.h5").string());
  EXPECT_EQ(measured.exit_code, 0) << measured.output;
  EXPECT_THAT(measured.output, HasSubstr("2 of 2 frames measured"));
}

TEST(Simulate, SaysWhatIsWrong) {
  const fs::path folder = testing::TestFolder();
  const std::string out = " -o " + (folder / "sim").string();
  const auto refused = [&](const std::string& arguments, int code, const std::string& words) {
    const auto result = RunPlumbline(arguments);
    EXPECT_EQ(result.exit_code, code) << arguments << ": " << result.output;
    EXPECT_THAT(result.output, HasSubstr(words)) << arguments;
    EXPECT_FALSE(fs::exists(folder / "sim")) << arguments;
  };
  refused("simulate tyre-squared" + out, 2, "There is no scenario 'tyre-squared'");
  refused("simulate" + out, 2, "scenario is missing");
  refused("simulate still --slip-angle 2" + out, 2, "There is no tyre in the scenario 'still'");
  refused("simulate tyre-flat --bits 7" + out, 2, "--bits takes");
  refused("simulate tyre-flat --drop 77" + out, 2, "Frame 77 cannot be dropped");
  refused("simulate tyre-flat --drop three" + out, 2, "--drop takes numbers");
  refused("simulate tyre-flat --mounting 1,2" + out, 2, "three angles");
  refused("simulate tyre-flat --images avi --bits 12" + out, 2, "Videos hold 8 bits");
  refused("simulate tyre-flat --images mkv --fps 0.01" + out, 2, "0.1 to 100000 frames a second");
  refused("simulate tyre-flat --lens 1" + out, 2, "lens is too short");
  refused("simulate tyre-flat --distance 300" + out, 2, "beyond the wheel's hub");
  refused("simulate tyre-flat --bend 1" + out, 2, "--calibration");
  refused("simulate tyre-flat --rig none.h5" + out, 3, "no rig file 'none.h5'");
  refused("simulate tyre-flat --calibration 3 --board chessboard:9x6:90mm" + out, 3, "too large");
  refused("simulate tyre-flat --exposure 100" + out, 2, "shorter than the time between frames");
  fs::create_directories(folder / "full");
  std::ofstream(folder / "full" / "mine.txt") << "mine";
  refused("simulate still -o " + (folder / "full").string(), 3, "not empty");
  refused("compare " + (folder / "none.h5").string() + " " + folder.string(), 3, "recipe.toml");
}

}  // namespace
}  // namespace plumbline
