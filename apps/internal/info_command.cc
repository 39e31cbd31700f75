#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/internal/command.h"
#include "apps/internal/result_file.h"

namespace plumbline::internal {
namespace {

class InfoCommand : public Command {
 public:
  std::string Name() const override { return "info"; }
  std::string Summary() const override { return "Tell what is in a run or a rig file."; }

  void Declare(OptionTable& options) override {
    options.Add(
        {.name = "FILE", .help = "a run or a rig file (.h5)", .required = true, .positional = true},
        &file_);
    options.Add({.name = "with-recipe", .help = "print the recipe that made it, too"}, &recipe_);
  }

  CommandReport Run(const CommonOptions&, const std::string&) override {
    const ResultFile file = OpenResultFile(file_);
    CommandReport report;
    report.json["file"] = file_;
    report.json["baseline_mm"] = file.rig->baseline_mm();
    report.json["calibration_modes"] = file.rig->modes.count();
    report.json["board"] = file.rig->board;
    if (file.series) {
      DescribeSeries(*file.series, report);
    } else {
      report.json["format"] = "plumbline-rig";
      report.text = fmt::format("{}: a calibrated stereo rig.\n", file_);
    }
    report.text += RigText(*file.rig);
    return report;
  }

 private:
  void DescribeSeries(const SeriesReader& series, CommandReport& report) const {
    const SeriesFacts& facts = series.facts();
    const ImageSize grid = series.grid_px().size();
    report.text =
        fmt::format("{}: a run of {} frames, {} by {} points a frame, every {} px.\n", file_,
                    series.frame_count(), grid.height, grid.width, series.step_px());
    report.text += fmt::format("  written {} by {}\n", facts.created, facts.software);
    report.json["format"] = "plumbline-series";
    report.json["created"] = facts.created;
    report.json["software"] = facts.software;
    report.json["recipe"] = facts.recipe_toml;
    report.json["inputs"] = nlohmann::json::parse(facts.inputs_json, nullptr, false);
    report.json["grid"] = {grid.height, grid.width};
    report.json["step_px"] = series.step_px();
    report.json["subset_px"] = series.subset_px();
    const std::vector<std::string> also = Names(series.contents());
    report.json["contents"] = also;
    report.json["channels"] = nlohmann::json::array();
    for (const Channel& channel : series.channels()) {
      report.json["channels"].push_back(channel.name);
    }
    if (!also.empty()) report.text += fmt::format("  with {}\n", fmt::join(also, ", "));
    report.json["frames"] = nlohmann::json::array();
    constexpr std::int64_t kMostLines = 20;
    for (std::int64_t i = 0; i < series.frame_count(); ++i) {
      const SeriesFrame frame = series.Frame(i);
      const auto& status = frame.surface.status.values();
      const auto valid = std::count(status.begin(), status.end(), Status::kOk);
      nlohmann::json row = {{"index", frame.index},
                            {"left", frame.left_id},
                            {"valid_points", valid},
                            {"problem", frame.problem},
                            {"plane", frame.ground.found}};
      std::string line = fmt::format("  frame {} ({})", frame.index, frame.left_id);
      if (std::isfinite(frame.time_s)) {
        row["time_s"] = frame.time_s;
        line += fmt::format(" at {:.3f} s", frame.time_s);
      }
      if (!frame.problem.empty()) {
        line += ": bad. " + frame.problem;
      } else {
        line += fmt::format(": {} points, in the {} frame", valid,
                            frame.surface.frame == SurfaceFrame::kGround ? "ground" : "rig");
        if (frame.ground.found) {
          row["plane_rms_mm"] = frame.ground.rms_mm;
          line += fmt::format(", plane rms {:.1f} um", 1000 * frame.ground.rms_mm);
        }
      }
      report.json["frames"].push_back(std::move(row));
      if (i < kMostLines) report.text += line + "\n";
    }
    if (series.frame_count() > kMostLines) {
      report.text += fmt::format("  ... {} more frames (--json lists all)\n",
                                 series.frame_count() - kMostLines);
    }
    if (recipe_) report.text += "Recipe:\n" + facts.recipe_toml;
  }

  std::string file_;
  bool recipe_ = false;
};

}  // namespace

std::unique_ptr<Command> MakeInfoCommand() { return std::make_unique<InfoCommand>(); }

}  // namespace plumbline::internal
