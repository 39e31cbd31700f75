#include <fmt/format.h>

#include <cstdio>
#include <filesystem>

#include "apps/command_line.h"
#include "apps/internal/command.h"
#include "calib/error.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// The photographs that Debian's opencv-doc brings: a paper chessboard of 9x6 inner corners in front
// of two small cameras, 13 pairs; 25 mm is the size of the squares that OpenCV's own files beside
// them state.
constexpr const char* kPhotographs = "/usr/share/doc/opencv-doc/examples/data";
constexpr const char* kBoard = "chessboard:9x6:25mm";
constexpr const char* kMeasuredPair = "03";
constexpr const char* kBoardRegion =
    "190,75,410,315";  // of the left image: where that pair shows the board

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
    return "The whole story on real photographs: calibrate, measure, look at the result.";
  }
  void Declare(OptionTable& options) override {
    options.Add({.name = "photographs",
                 .help = "folder with left01.jpg ... right14.jpg of Debian's opencv-doc",
                 .unit = "FOLDER"},
                &photographs_);
    options.Add(
        {.name = "output", .help = "folder for the results", .unit = "FOLDER", .short_name = "o"},
        &output_);
  }
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  std::string photographs_ = kPhotographs, output_ = "plumbline-demo";
};

CommandReport DemoCommand::Run(const CommonOptions& common, const std::string&) {
  const fs::path photographs = photographs_;
  if (!fs::exists(photographs / "left01.jpg")) {
    throw InputError(
        fmt::format("There is no left01.jpg in '{}'; install Debian's package opencv-doc, or name "
                    "its photographs with --photographs.",
                    photographs_));
  }
  const fs::path output = fs::absolute(output_).lexically_normal();
  std::error_code error;
  fs::create_directories(output, error);
  if (error)
    throw EnvironmentError(
        fmt::format("The folder '{}' cannot be made: {}.", output.string(), error.message()));
  const auto result = [&](const char* name) { return (output / name).string(); };
  const auto photograph = [&](const std::string& name) {
    return (photographs / (name + ".jpg")).string();
  };
  const auto step = [&](const std::string& title, std::vector<std::string> arguments) {
    if (common.quiet) arguments.emplace_back("-q");
    RunStep(title, arguments);
  };
  step("1. From photographs of a board to a calibrated rig",
       {"calibrate", "--board", kBoard, "--left", photograph("left[01]?"), "--right",
        photograph("right[01]?"), "-o", result("rig.h5")});
  step("2. From a pair of images to a surface with error bars",
       {"measure", "--rig", result("rig.h5"), "--left",
        photograph(std::string("left") + kMeasuredPair), "--right",
        photograph(std::string("right") + kMeasuredPair), "--roi", kBoardRegion, "-o",
        result("run.h5"), "--overwrite"});
  step("3. Is the file whole?", {"validate", result("run.h5")});
  step("4. As points for other programs",
       {"export", result("run.h5"), "--format", "ply", "-o", result("run.ply")});
  CommandReport report;
  report.text = fmt::format(
      "\nThat was the whole story. Everything is in {}:\n"
      "  rig.h5   the calibrated rig with its error bars; left.cameramodel and right.cameramodel "
      "are for\n"
      "           mrcal's tools, rig.yaml is for OpenCV\n"
      "  run.h5   the surface with its random and its calibration sigmas, and the ground plane.\n"
      "           In Python: h5py.File('run.h5')['surface/position'][0], and beside it\n"
      "           position_errors_random and position_errors_calibration\n"
      "  run.ply  the points, for MeshLab, CloudCompare or ParaView\n"
      "The scale rests on the board's squares being 25 mm, as OpenCV's own files say; nobody "
      "measured this sheet.\n",
      output.string());
  report.json = {
      {"rig", result("rig.h5")}, {"run", result("run.h5")}, {"points", result("run.ply")}};
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeDemoCommand() { return std::make_unique<DemoCommand>(); }

}  // namespace plumbline::internal
