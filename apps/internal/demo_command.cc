#include <fmt/format.h>

#include <cstdio>
#include <filesystem>

#include "apps/command_line.h"
#include "apps/internal/command.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

constexpr const char* kScenario = "cleat-lateral-square38";
constexpr const char* kBoard = "charuco:11x8:12mm:9mm:DICT_5X5_100";

// Runs one command as a user would, showing the line first.
void RunStep(const std::string& title, const std::vector<std::string>& arguments) {
  std::string line = "plumbline";
  for (const std::string& a : arguments) {
    line += a.find_first_of("*?[ ") == std::string::npos ? " " + a : " '" + a + "'";
  }
  fmt::print("\n== {}\n$ {}\n\n", title, line);
  std::fflush(stdout);
  if (const int code = RunCommandLine(arguments); code != 0) {
    throw InputError(fmt::format(
        "The demo stopped: '{}' ended with exit code {}; its message is above.", line, code));
  }
}

class DemoCommand : public Command {
 public:
  std::string Name() const override { return "demo"; }
  std::string Summary() const override {
    return "The whole story on the virtual rig: photograph, calibrate, measure, hold against "
           "truth.";
  }
  void Declare(OptionTable& options) override {
    options.Add(
        {.name = "output", .help = "folder for the results", .unit = "FOLDER", .short_name = "o"},
        &output_);
  }
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  std::string output_ = "plumbline-demo";
};

CommandReport DemoCommand::Run(const CommonOptions& common, const std::string&) {
  const fs::path output = fs::absolute(output_).lexically_normal();
  const auto path = [&](const char* name) { return (output / name).string(); };
  const auto step = [&](const std::string& title, std::vector<std::string> arguments) {
    if (common.quiet) arguments.emplace_back("-q");
    RunStep(title, arguments);
  };
  step(
      "1. A tyre rolls over a 38 mm bar; two cameras inside it look on, and before that at a board",
      {"simulate", kScenario, "--calibration", "24", "-o", path("recording"), "--overwrite"});
  step("2. From the photographs of the board to a calibrated rig",
       {"calibrate", "--board", kBoard, "--left", path("recording/calibration/left"), "--right",
        path("recording/calibration/right"), "-o", path("rig.h5")});
  step("3. From the recording to surfaces with error bars",
       {"measure", "--rig", path("rig.h5"), "--left", path("recording/left"), "--right",
        path("recording/right"), "--timestamps", path("recording/timestamps.csv"), "--step", "4",
        "-o", path("run.h5"), "--overwrite"});
  step("4. Measured against true", {"compare", path("run.h5"), path("recording")});
  step("5. Is the file whole?", {"validate", path("run.h5")});
  step("6. As points for other programs",
       {"export", path("run.h5"), "--format", "ply", "-o", path("run.ply")});
  CommandReport report;
  report.text = fmt::format(
      "\nThat was the whole story. Everything is in {}:\n"
      "  recording/  what the cameras saw, left and right; truth.h5, what was there: shape, "
      "strain,\n"
      "              contact patch, slip of every frame; channels.csv, what the vehicle logged\n"
      "  rig.h5      the calibrated rig with its error bars; left.cameramodel and "
      "right.cameramodel\n"
      "              are for mrcal's tools, rig.yaml is for OpenCV\n"
      "  run.h5      the surfaces with their random and their calibration sigmas.\n"
      "              In Python: h5py.File('run.h5')['surface/position'][0], and beside it\n"
      "              position_errors_random and position_errors_calibration\n"
      "  run_0000.ply and so on: the points, for MeshLab, CloudCompare or ParaView\n"
      "The table of step 4 says how far off it was, and how far off it said it might be. Where the "
      "bar is under the\ntyre no plane, or not the ground's, is found, and a few points beside "
      "hidden "
      "places are matched wrongly.\n",
      output.string());
  report.json = {{"recording", path("recording")},
                 {"rig", path("rig.h5")},
                 {"run", path("run.h5")},
                 {"points", path("run.ply")}};
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeDemoCommand() { return std::make_unique<DemoCommand>(); }

}  // namespace plumbline::internal
