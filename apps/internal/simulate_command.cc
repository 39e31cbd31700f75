#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "apps/internal/command.h"
#include "apps/internal/simulate_options.h"
#include "apps/interrupt.h"
#include "io/virtual_rig/recording.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

CommandReport ScenarioList() {
  CommandReport report;
  report.json["scenarios"] = nlohmann::json::array();
  for (const ScenarioEntry& entry : ListScenarios()) {
    report.text += fmt::format("{:<30} {}\n", entry.name, entry.summary);
    report.json["scenarios"].push_back({{"name", entry.name}, {"summary", entry.summary}});
  }
  report.text +=
      "Numbers as 5.3.2 are the sections of the thesis whose tests these repeat.\n"
      "plumbline simulate NAME -o FOLDER renders one; --help tells what can be changed.\n";
  return report;
}

class SimulateCommand : public Command {
 public:
  std::string Name() const override { return "simulate"; }
  std::string Summary() const override {
    return "Render a recording of the virtual rig, with its exact truth in the same schema.";
  }
  std::string Footer() const override {
    return "Examples:\n"
           "  plumbline simulate list\n"
           "  plumbline simulate tyre-flat -o sim --calibration 30\n"
           "Then measure it as if it were real, and hold the result against the truth:\n"
           "  plumbline calibrate --board charuco:11x8:12mm:9mm:DICT_5X5_100 \\\n"
           "      --left sim/calibration/left --right sim/calibration/right -o rig.h5\n"
           "  plumbline measure --rig rig.h5 --left sim/left --right sim/right -o run.h5\n"
           "  plumbline compare run.h5 sim";
  }
  void Declare(OptionTable& options) override {
    options.Add({.name = "output",
                 .help = "folder for images, rig, truth and channels",
                 .unit = "FOLDER",
                 .short_name = "o",
                 .in_recipe = false},
                &output_);
    options.Add(
        {.name = "overwrite", .help = "write into a folder that is not empty", .in_recipe = false},
        &overwrite_);
    simulate_.Declare(options);
  }
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  SimulateOptions simulate_;
  std::string output_;
  bool overwrite_ = false;
};

CommandReport SimulateCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  if (simulate_.scenario() == "list") return ScenarioList();
  const VirtualRig rig = simulate_.Rig(common.seed);
  const fs::path folder = output_.empty() ? fs::path(simulate_.scenario()) : fs::path(output_);
  RecordingOptions options = simulate_.Recording(rig.scenario(), common.seed);
  options.recipe_toml = recipe_toml;
  options.overwrite = overwrite_;
  const InterruptGuard guard;
  std::unique_ptr<Progress> progress;
  const Recording recording =
      WriteRecording(rig, folder, options, [&](const std::string& stage, int done, int total) {
        if (done == 1) {
          progress.reset();
          progress = std::make_unique<Progress>(stage, total, common.progress());
        }
        progress->Advance();
        return !InterruptGuard::Requested();
      });
  progress.reset();
  CommandReport report;
  report.text = fmt::format("{}: {}.\n{} frames", rig.scenario().name, rig.scenario().summary,
                            recording.frames);
  if (options.calibration) {
    report.text += fmt::format(" and {} pairs of photographs of {}", recording.calibration_pairs,
                               options.calibration->board.Word());
    report.json["board"] = options.calibration->board.Word();
  }
  report.text += fmt::format(" are in {}:\n", folder.string());
  for (const fs::path& file : recording.files) {
    report.text += fmt::format("  {}{}\n", fs::relative(file, folder).string(),
                               fs::is_directory(file) ? "/" : "");
    report.json["files"].push_back(file.string());
  }
  report.json["frames"] = recording.frames;
  report.json["calibration_pairs"] = recording.calibration_pairs;
  report.json["interrupted"] = recording.interrupted;
  if (recording.interrupted) {
    report.text +=
        "Stopped before the end; what is there is whole. Start again with --overwrite.\n";
    report.exit_code = 130;
  }
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeSimulateCommand() { return std::make_unique<SimulateCommand>(); }

}  // namespace plumbline::internal
