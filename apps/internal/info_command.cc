#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/internal/command.h"
#include "apps/internal/planar_report.h"
#include "apps/internal/result_file.h"
#include "apps/internal/wheel_report.h"
#include "io/wheel_file.h"

namespace plumbline::internal {
namespace {

class InfoCommand : public Command {
 public:
  std::string Name() const override { return "info"; }
  std::string Summary() const override { return "Tell what is in a run, a rig or a wheel file."; }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "a run, a rig or a wheel file (.h5)",
                 .required = true,
                 .positional = true},
                &file_);
    options.Add({.name = "with-recipe", .help = "print the recipe that made it, too"}, &recipe_);
  }

  CommandReport Run(const CommonOptions&, const std::string&) override {
    CommandReport report;
    if (IsWheelFile(file_)) {
      const WheelReference wheel = ReadWheelFile(file_);
      report.json = JsonOf(wheel);
      report.json["format"] = "plumbline-wheel";
      report.json["file"] = file_;
      report.text = fmt::format("{}: the reference of a wheel.\n", file_) + TextOf(wheel) +
                    RigText(wheel.rig);
      return report;
    }
    const ResultFile file = OpenResultFile(file_);
    report.json["file"] = file_;
    if (file.planar) {
      DescribePlanar(*file.planar, report);
      return report;
    }
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
    DescribeFacts(facts, report);
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
    for (std::int64_t i = 0; i < series.frame_count(); ++i) {
      const SeriesFrame frame = series.Frame(i);
      const auto valid = CountOk(frame.surface.status);
      nlohmann::json row = {{"index", frame.index},
                            {"left", frame.left_id},
                            {"valid_points", valid},
                            {"problem", frame.problem},
                            {"plane", frame.ground.found}};
      std::string line = FrameLine(frame.index, frame.left_id, frame.time_s, row);
      if (!frame.problem.empty()) {
        line += ": bad. " + frame.problem;
      } else {
        line += fmt::format(": {} points, in the {} frame", valid,
                            frame.surface.frame == SurfaceFrame::kGround ? "ground" : "rig");
        if (frame.ground.found && std::isfinite(frame.ground.rms_mm)) {
          row["plane_rms_mm"] = frame.ground.rms_mm;
          line += fmt::format(", plane rms {:.1f} um", 1000 * frame.ground.rms_mm);
        }
      }
      report.json["frames"].push_back(std::move(row));
      if (i < kMostLines) report.text += line + "\n";
    }
    DescribeEnd(series.frame_count(), facts, report);
  }

  void DescribePlanar(const PlanarSeriesReader& series, CommandReport& report) const {
    const PlanarSeriesHeader& header = series.header();
    report.text = fmt::format(
        "{}: a run of one camera, {} frames, {} by {} points a frame, every {} px, subset {} px, "
        "order {}.\n",
        file_, series.frame_count(), header.grid.height, header.grid.width, header.step_px,
        header.subset_px, header.order);
    DescribeFacts(series.facts(), report);
    report.json["geometry"] = "planar";
    report.json["grid"] = {header.grid.height, header.grid.width};
    report.json["step_px"] = header.step_px;
    report.json["subset_px"] = header.subset_px;
    report.json["order"] = header.order;
    report.json["interpolation"] = header.interpolation;
    report.json["prefilter"] = header.prefilter;
    report.json["prefilter_sigma_px"] = header.prefilter_sigma_px;
    report.json["reference"] = header.reference;
    report.json["reference_id"] = header.reference_id;
    report.json["contents"] = Names(header.contents);
    report.json["camera"] = {
        {"size", {header.camera.image_size.width, header.camera.image_size.height}},
        {"bits", header.camera.bits},
        {"noise_offset_grey2", FiniteJson(header.camera.noise.offset_grey2)},
        {"noise_slope_grey", FiniteJson(header.camera.noise.slope_grey)},
        {"noise_source", header.camera.noise_source}};
    const std::string noise =
        std::isfinite(header.camera.noise.offset_grey2)
            ? fmt::format(" variance {:.3g} + {:.3g} g at grey level g",
                          header.camera.noise.offset_grey2, header.camera.noise.slope_grey)
            : "";
    report.text += fmt::format(
        "  camera: {}x{} px, {} bits; noise{}{}\n", header.camera.image_size.width,
        header.camera.image_size.height, header.camera.bits, noise,
        header.camera.noise_source.empty()
            ? ""
            : fmt::format("{}from {}", noise.empty() ? " " : ", ", header.camera.noise_source));
    if (header.contents.strain) {
      report.json["strain_measure"] = header.strain_measure;
      report.json["vsg_px"] = header.vsg_px;
      report.json["window_points"] = header.window_points;
      report.text +=
          fmt::format("  strain: {}, gauge of {} px, {} by {} points\n", header.strain_measure,
                      header.vsg_px, header.window_points, header.window_points);
    }
    DescribePlanarFrames(series, report);
    DescribeEnd(series.frame_count(), series.facts(), report);
  }

  static void DescribePlanarFrames(const PlanarSeriesReader& series, CommandReport& report) {
    report.json["frames"] = nlohmann::json::array();
    for (std::int64_t i = 0; i < series.frame_count(); ++i) {
      const PlanarSeriesFrame frame = series.Frame(i);
      const auto valid = CountOk(frame.field.status);
      nlohmann::json row = {{"index", frame.index},
                            {"image", frame.id},
                            {"valid_points", valid},
                            {"problem", frame.problem},
                            {"reference_index", frame.reference_index}};
      std::string line = FrameLine(frame.index, frame.id, frame.time_s, row);
      if (!frame.problem.empty()) {
        line += ": bad. " + frame.problem;
      } else {
        line += fmt::format(": {} points", valid);
      }
      if (series.header().contents.strain && frame.problem.empty()) {
        row["strain_points"] = CountOk(frame.strain.status);
        line += fmt::format(", {} with strain", CountOk(frame.strain.status));
      }
      report.json["frames"].push_back(std::move(row));
      if (i < kMostLines) report.text += line + "\n";
    }
  }

  static constexpr std::int64_t kMostLines = 20;

  static std::int64_t CountOk(const Image<Status>& status) {
    return std::count(status.values().begin(), status.values().end(), Status::kOk);
  }

  // How the line of a frame begins; adds the time to its row.
  static std::string FrameLine(std::int64_t index, const std::string& id, double time_s,
                               nlohmann::json& row) {
    std::string line = fmt::format("  frame {} ({})", index, id);
    if (!std::isfinite(time_s)) return line;
    row["time_s"] = time_s;
    return line + fmt::format(" at {:.3f} s", time_s);
  }

  static void DescribeFacts(const SeriesFacts& facts, CommandReport& report) {
    report.text += fmt::format("  written {} by {}\n", facts.created, facts.software);
    if (facts.shard) {
      report.text +=
          fmt::format("  shard {} of {}, from frame {} of {}\n", facts.shard->index + 1,
                      facts.shard->count, facts.shard->first_frame, facts.shard->frame_count);
      report.json["shard"] = fmt::format("{}/{}", facts.shard->index + 1, facts.shard->count);
    }
    if (facts.goes_on) report.text += "  the run goes on: more frames will come\n";
    report.json["format"] = "plumbline-series";
    report.json["goes_on"] = facts.goes_on;
    report.json["created"] = facts.created;
    report.json["software"] = facts.software;
    report.json["recipe"] = facts.recipe_toml;
    report.json["inputs"] = nlohmann::json::parse(facts.inputs_json, nullptr, false);
  }

  void DescribeEnd(std::int64_t frames, const SeriesFacts& facts, CommandReport& report) const {
    if (frames > kMostLines) {
      report.text += fmt::format("  ... {} more frames (--json lists all)\n", frames - kMostLines);
    }
    if (recipe_) report.text += "Recipe:\n" + facts.recipe_toml;
  }

  std::string file_;
  bool recipe_ = false;
};

}  // namespace

std::unique_ptr<Command> MakeInfoCommand() { return std::make_unique<InfoCommand>(); }

}  // namespace plumbline::internal
