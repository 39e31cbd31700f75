#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <functional>

#include "apps/internal/command.h"
#include "apps/internal/contact_options.h"
#include "apps/internal/result_file.h"
#include "calib/error.h"
#include "io/bump_table.h"
#include "io/export.h"
#include "io/frame_table.h"
#include "io/section_table.h"
#include "io/series_points.h"
#include "io/series_start.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

std::int64_t CountOk(const Image<Status>& status) {
  return std::count(status.values().begin(), status.values().end(), Status::kOk);
}

class ExportCommand : public Command {
 public:
  std::string Name() const override { return "export"; }
  std::string Summary() const override {
    return "Write the points of a run, or a table of its frames or bumps, for other programs (PLY, "
           "CSV).";
  }
  std::string Footer() const override {
    return "Example:\n  plumbline export run.h5 --format ply -o run.ply   (CloudCompare, MeshLab, "
           "ParaView)\n  plumbline export run.h5 --format frames -o frames.csv   (a line a frame: "
           "plane, wheel, patch, slip)\n"
           "  plumbline export run.h5 --format bumps -o bumps.csv   (a line a bump: what the tyre "
           "rolls over)";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "a run, as plumbline measure or correlate writes it",
                 .required = true,
                 .positional = true},
                &file_);
    options.Add(
        {.name = "format",
         .help =
             "of the valid points: ply is binary, csv is text; of one camera csv, with all "
             "points and their status. frames: of each frame as a whole, a line of one csv. bumps: "
             "of each rise of the surface over the ground, as over a nut under a tyre, found by "
             "itself",
         .choices = {"ply", "csv", "frames", "bumps"}},
        &format_);
    options.Add(
        {.name = "section",
         .help = "in place of the points, the line in which a plane cuts the surface: x=150 "
                 "(lateral) or y=0 (longitudinal), mm in the frame of the positions; a csv "
                 "with the sigmas of the line"},
        &section_);
    options.Add(
        {.name = "carcass",
         .help = "with bumps: thickness of the carcass over which they rise, as for plumbline "
                 "measure; empty: that of the run's recipe",
         .unit = "mm"},
        &carcass_);
    options.Add({.name = "least-height",
                 .help = "with bumps: of one above its surroundings",
                 .unit = "mm",
                 .min = 0.1,
                 .max = 1e3},
                &bump_.least_height_mm);
    options.Add({.name = "output",
                 .help = "where the points go; empty: beside the run. Of several frames, each gets "
                         "a file with its number",
                 .unit = "FILE",
                 .short_name = "o"},
                &output_);
    options.Add({.name = "frame", .help = "which frame of the run, from 0; auto: all", .min = 0},
                &frame_);
  }

  CommandReport Run(const CommonOptions& common, const std::string&) override {
    const ResultFile result = OpenResultFile(file_);
    if (result.planar) {
      if (format_ != "csv" || !section_.empty()) {
        throw UsageError("'" + file_ +
                         "' is of one camera: its points have no place in space, and there "
                         "is no table of its frames. Export them with --format csv.");
      }
      return Export(common, result.planar->frame_count(), [&](std::int64_t i, const fs::path& to) {
        const PlanarSeriesFrame frame = result.planar->Frame(i);
        if (frame.problem.empty()) ExportCsv(to, frame, CsvPoints::kAll);
        return Exported{frame.problem, CountOk(frame.field.status)};
      });
    }
    if (!result.series) {
      throw InputError(fmt::format("'{}' is a rig file, which has no points.", file_));
    }
    if (!section_.empty()) return ExportSections(common, *result.series);
    if (format_ == "frames") return ExportTable(*result.series);
    if (format_ == "bumps") return ExportBumpTable(*result.series);
    return Export(common, result.series->frame_count(), [&](std::int64_t i, const fs::path& to) {
      const SeriesFrame frame = result.series->Frame(i);
      if (frame.problem.empty() && format_ == "ply") ExportPly(to, frame);
      if (frame.problem.empty() && format_ == "csv") ExportCsv(to, frame);
      return Exported{frame.problem, CountOk(frame.surface.status)};
    });
  }

 private:
  struct Exported {
    std::string problem;  // why nothing was written
    std::int64_t valid_points = 0;
  };

  // write(i, name of its file) writes frame i.
  CommandReport Export(const CommonOptions& common, std::int64_t count,
                       const std::function<Exported(std::int64_t, const fs::path&)>& write) const {
    if (frame_ && *frame_ >= count) {
      throw UsageError(
          fmt::format("--frame {}: '{}' has {} frames, counted from 0.", *frame_, file_, count));
    }
    const fs::path base = OutputFile(section_.empty() ? format_ : "section.csv");
    CommandReport report;
    report.json["files"] = nlohmann::json::array();
    std::int64_t skipped = 0;
    const std::int64_t first = frame_.value_or(0);
    const std::int64_t last = frame_ ? first + 1 : count;
    Progress progress("writing", last - first, common.progress());
    for (std::int64_t i = first; i < last; ++i, progress.Advance()) {
      const fs::path file = last - first > 1 ? NumberedFile(base, i) : base;
      const Exported exported = write(i, file);
      if (!exported.problem.empty() && frame_) {
        throw InputError(fmt::format("Frame {} has no points: {}", i, exported.problem));
      }
      if (!exported.problem.empty()) {
        ++skipped;
        continue;
      }
      report.json["files"].push_back(
          {{"file", file.string()}, {"frame", i}, {"points", exported.valid_points}});
      if (last - first > 8) continue;
      report.text += fmt::format("Wrote {} valid points of frame {} to {}.\n",
                                 exported.valid_points, i, file.string());
    }
    if (last - first > 8) {
      report.text += fmt::format("Wrote {} files, {} and so on.\n", last - first - skipped,
                                 NumberedFile(base, first).string());
    }
    if (skipped > 0) {
      report.text += fmt::format("{} frames are marked as bad and have no points.\n", skipped);
    }
    report.json["bad_frames"] = skipped;
    return report;
  }

  CommandReport ExportSections(const CommonOptions& common, const SeriesReader& series) const {
    const CutPlane plane = ParseSection(section_);
    const NeighbourCorrelation neighbours = NeighboursOf(series);
    return Export(common, series.frame_count(), [&](std::int64_t i, const fs::path& to) {
      const SeriesFrame frame = series.Frame(i);
      if (!frame.problem.empty()) return Exported{frame.problem, 0};
      const std::size_t points = ExportSection(to, frame, plane, neighbours);
      return Exported{"", static_cast<std::int64_t>(points)};
    });
  }

  CommandReport ExportTable(const SeriesReader& series) const {
    const fs::path file = TableFile();
    ExportFrameTable(file, series);
    CommandReport report;
    report.json = {{"file", file.string()}, {"frames", series.frame_count()}};
    report.text =
        fmt::format("Wrote {} frames, a line each, to {}.\n", series.frame_count(), file.string());
    return report;
  }

  CommandReport ExportBumpTable(const SeriesReader& series) const {
    const fs::path file = TableFile();
    std::string carcass = carcass_;
    // As it was analysed last.
    for (const char* command : {"analyse", "measure"}) {
      if (carcass.empty()) carcass = RecipeText(series.facts().recipe_toml, command, "carcass");
    }
    const std::vector<FrameBumps> frames =
        FindBumpsOf(series, ParseCarcass(carcass.empty() ? "0" : carcass, 0), bump_);
    ExportBumps(file, frames);
    std::int64_t bumps = 0, with = 0, without_ground = 0;
    std::string problem;
    for (const FrameBumps& frame : frames) {
      bumps += std::ssize(frame.bumps);
      with += frame.bumps.empty() ? 0 : 1;
      without_ground += frame.problem.empty() ? 0 : 1;
      if (problem.empty()) problem = frame.problem;
    }
    CommandReport report;
    report.json = {{"file", file.string()},
                   {"frames", frames.size()},
                   {"bumps", bumps},
                   {"frames_with_bumps", with},
                   {"frames_not_searched", without_ground}};
    report.text = fmt::format("Wrote {} bumps, in {} of {} frames, to {}.\n", bumps, with,
                              frames.size(), file.string());
    if (without_ground > 0) {
      report.text +=
          fmt::format("{} frames were not searched; the first one: {}.\n", without_ground, problem);
    }
    return report;
  }

  // Of a table of all frames.
  fs::path TableFile() const {
    if (frame_) {
      throw UsageError(fmt::format("--frame and --format {} exclude each other.", format_));
    }
    return OutputFile(format_ + ".csv");
  }

  // The one that is named, with the format's ending where the name has none; or beside the run.
  fs::path OutputFile(const std::string& ending) const {
    if (output_.empty()) return fs::path(file_).replace_extension("." + ending);
    fs::path file(output_);
    if (!file.has_extension()) file += fs::path("run." + ending).extension();
    return file;
  }

  BumpOptions bump_;
  std::string file_, output_, section_, carcass_, format_ = "ply";
  std::optional<int> frame_;
};

}  // namespace

std::unique_ptr<Command> MakeExportCommand() { return std::make_unique<ExportCommand>(); }

}  // namespace plumbline::internal
