#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "apps/internal/command.h"
#include "calib/error.h"
#include "io/export.h"
#include "io/series_reader.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// "surface.ply" and frame 7 of several: "surface_0007.ply".
fs::path NumberedFile(const fs::path& file, std::int64_t index) {
  return file.parent_path() /
         fmt::format("{}_{:04}{}", file.stem().string(), index, file.extension().string());
}

class ExportCommand : public Command {
 public:
  std::string Name() const override { return "export"; }
  std::string Summary() const override {
    return "Write the points of a run for other programs (PLY, CSV).";
  }
  std::string Footer() const override {
    return "Example:\n  plumbline export run.h5 --format ply -o run.ply   (CloudCompare, MeshLab, "
           "ParaView)";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "FILE",
                 .help = "a run, as plumbline measure writes it",
                 .required = true,
                 .positional = true},
                &file_);
    options.Add({.name = "format",
                 .help = "of the valid points: ply is binary, csv is text",
                 .choices = {"ply", "csv"}},
                &format_);
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
    const SeriesReader series(file_);
    const std::int64_t count = series.frame_count();
    if (frame_ && *frame_ >= count) {
      throw UsageError(
          fmt::format("--frame {}: '{}' has {} frames, counted from 0.", *frame_, file_, count));
    }
    const fs::path base =
        output_.empty() ? fs::path(file_).replace_extension("." + format_) : fs::path(output_);
    CommandReport report;
    report.json["files"] = nlohmann::json::array();
    std::int64_t skipped = 0;
    const std::int64_t first = frame_.value_or(0);
    const std::int64_t last = frame_ ? first + 1 : count;
    {
      Progress progress("writing", last - first, common.progress());
      for (std::int64_t i = first; i < last; ++i, progress.Advance()) {
        const SeriesFrame frame = series.Frame(i);
        if (!frame.problem.empty()) {
          if (frame_) {
            throw InputError(fmt::format("Frame {} has no points: {}", i, frame.problem));
          }
          ++skipped;
          continue;
        }
        const fs::path file = last - first > 1 ? NumberedFile(base, i) : base;
        if (format_ == "ply") {
          ExportPly(file, frame);
        } else {
          ExportCsv(file, frame);
        }
        const auto& status = frame.surface.status.values();
        const auto points = std::count(status.begin(), status.end(), Status::kOk);
        report.json["files"].push_back({{"file", file.string()}, {"frame", i}, {"points", points}});
        if (last - first <= 8) {
          report.text +=
              fmt::format("Wrote {} valid points of frame {} to {}.\n", points, i, file.string());
        }
      }
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

 private:
  std::string file_, output_, format_ = "ply";
  std::optional<int> frame_;
};

}  // namespace

std::unique_ptr<Command> MakeExportCommand() { return std::make_unique<ExportCommand>(); }

}  // namespace plumbline::internal
