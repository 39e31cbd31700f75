#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <functional>

#include "apps/internal/command.h"
#include "apps/internal/result_file.h"
#include "calib/error.h"
#include "io/export.h"
#include "io/frame_table.h"
#include "io/section_table.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// "surface.ply" and frame 7 of several: "surface_0007.ply".
fs::path NumberedFile(const fs::path& file, std::int64_t index) {
  return file.parent_path() /
         fmt::format("{}_{:04}{}", file.stem().string(), index, file.extension().string());
}

std::int64_t CountOk(const Image<Status>& status) {
  return std::count(status.values().begin(), status.values().end(), Status::kOk);
}

class ExportCommand : public Command {
 public:
  std::string Name() const override { return "export"; }
  std::string Summary() const override {
    return "Write the points of a run, or a table of its frames, for other programs (PLY, CSV).";
  }
  std::string Footer() const override {
    return "Example:\n  plumbline export run.h5 --format ply -o run.ply   (CloudCompare, MeshLab, "
           "ParaView)\n  plumbline export run.h5 --format frames -o frames.csv   (a line a frame: "
           "plane, "
           "wheel, patch, slip)";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "a run, as plumbline measure or correlate writes it",
                 .required = true,
                 .positional = true},
                &file_);
    options.Add(
        {.name = "format",
         .help = "of the valid points: ply is binary, csv is text; of one camera csv, with all "
                 "points and their status. frames: of each frame as a whole, a line of one csv",
         .choices = {"ply", "csv", "frames"}},
        &format_);
    options.Add(
        {.name = "section",
         .help = "in place of the points, the line in which a plane cuts the surface: x=150 "
                 "(lateral) or y=0 (longitudinal), mm in the frame of the positions; a csv "
                 "with the sigmas of the line"},
        &section_);
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
    const std::string ending = section_.empty() ? format_ : "section.csv";
    const fs::path base =
        output_.empty() ? fs::path(file_).replace_extension("." + ending) : fs::path(output_);
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
    return Export(common, series.frame_count(), [&](std::int64_t i, const fs::path& to) {
      const SeriesFrame frame = series.Frame(i);
      if (!frame.problem.empty()) return Exported{frame.problem, 0};
      const std::size_t points =
          ExportSection(to, frame, plane, series.step_px(), series.subset_px());
      return Exported{"", static_cast<std::int64_t>(points)};
    });
  }

  CommandReport ExportTable(const SeriesReader& series) const {
    if (frame_) throw UsageError("--frame and --format frames exclude each other.");
    const fs::path file =
        output_.empty() ? fs::path(file_).replace_extension(".frames.csv") : fs::path(output_);
    ExportFrameTable(file, series);
    CommandReport report;
    report.json = {{"file", file.string()}, {"frames", series.frame_count()}};
    report.text =
        fmt::format("Wrote {} frames, a line each, to {}.\n", series.frame_count(), file.string());
    return report;
  }

  std::string file_, output_, section_, format_ = "ply";
  std::optional<int> frame_;
};

}  // namespace

std::unique_ptr<Command> MakeExportCommand() { return std::make_unique<ExportCommand>(); }

}  // namespace plumbline::internal
