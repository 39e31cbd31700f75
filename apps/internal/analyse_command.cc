#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <functional>

#include "apps/internal/command.h"
#include "apps/internal/measure_report.h"
#include "apps/internal/planar_report.h"
#include "apps/internal/result_file.h"
#include "apps/internal/rolling_analysis.h"
#include "apps/internal/series_neighbours.h"
#include "apps/internal/stereo_options.h"
#include "apps/internal/surface_records.h"
#include "apps/interrupt.h"
#include "calib/error.h"
#include "io/planar_series_writer.h"
#include "io/series_writer.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

constexpr const char* kStopped = "only the frames up to here are in the file.";

// The recipe of the run with that of this command behind it, in place of an earlier one.
std::string JoinRecipes(const std::string& run, const std::string& own) {
  const std::string heading = "[analyse]\n";
  const std::size_t earlier = run.rfind("\n" + heading);
  std::string joined = run.substr(0, earlier == std::string::npos ? run.size() : earlier + 1);
  if (!joined.empty() && joined.back() != '\n') joined += '\n';
  return joined + own;
}

class AnalyseCommand : public Command {
 public:
  std::string Name() const override { return "analyse"; }
  std::string Summary() const override {
    return "Work out strain, plane and frames of a run again, with other settings, without "
           "correlating again.";
  }
  std::string Footer() const override {
    return "Example:\n"
           "  plumbline analyse run.h5 -o strain.h5 --strain-window 15 --strain-measure hencky\n"
           "Of a run of one camera only the options of strain count. Of a run of a rolling tyre "
           "what is not given stays as it was measured, or analysed last.";
  }
  void Declare(OptionTable& options) override;
  void Complete(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  struct Row {
    std::int64_t index = 0;
    std::string id, problem;
    PlanarSummary summary;
  };
  CommandReport Report(const fs::path& output, const PlanarSeriesHeader& header,
                       const std::string& note, const std::vector<Row>& rows,
                       bool interrupted) const;

  CommandReport RunPlanar(const PlanarSeriesReader& series, const CommonOptions& common,
                          const std::string& recipe_toml);
  CommandReport RunStereo(const SeriesReader& series, const CommonOptions& common,
                          const std::string& recipe_toml) const;
  CommandReport RunRolling(const SeriesReader& series, const CommonOptions& common,
                           const std::string& recipe_toml) const;
  // Writes and reports all frames of the run, each as `again` tells it.
  using Again = std::function<ReportedFrame(const SeriesFrame& before, std::int64_t position)>;
  CommandReport WriteFrames(const SeriesReader& series, SeriesHeader header,
                            const std::vector<std::string>& notes, const CommonOptions& common,
                            const Again& again) const;
  fs::path Output() const;

  std::string file_, output_;
  bool overwrite_ = false;
  EvaluationOptionSet evaluation_;
  RollingAnalysisOptionSet rolling_;
};

void AnalyseCommand::Declare(OptionTable& options) {
  options.Add({.name = "FILE",
               .help = "a run of a rig (measure --matcher dic) or of one camera (correlate)",
               .required = true,
               .positional = true},
              &file_);
  options.Add({.name = "output",
               .help = "where the result goes: the same frames and displacements, strain anew",
               .unit = "FILE",
               .short_name = "o",
               .required = true},
              &output_);
  options.Add({.name = "overwrite", .help = "replace the output file if it is there"}, &overwrite_);
  evaluation_.DeclareGround(options);
  evaluation_.Declare(options, StrainOptionSet::Of::kEither);
  rolling_.Declare(options);
}

bool IsRolling(const SeriesReader& series) { return series.displacement_reference() == "wheel"; }

void AnalyseCommand::Complete(OptionTable& options) {
  const std::optional<std::string> path = options.Text("FILE");
  if (!path) return;
  try {
    const ResultFile file = OpenResultFile(*path);
    if (file.series && IsRolling(*file.series)) {
      rolling_.Complete(file.series->facts().recipe_toml, options);
    }
  } catch (const InputError&) {  // Run() says it
  }
}

CommandReport AnalyseCommand::Report(const fs::path& output, const PlanarSeriesHeader& header,
                                     const std::string& note, const std::vector<Row>& rows,
                                     bool interrupted) const {
  constexpr std::size_t kMostFrames = 6;
  CommandReport report;
  report.text = GaugeText(header);
  report.json = {{"output", output.string()},
                 {"strain_measure", header.strain_measure},
                 {"strain_window", header.window_points},
                 {"vsg_px", header.vsg_px},
                 {"interrupted", interrupted},
                 {"notes", nlohmann::json::array()},
                 {"frames", nlohmann::json::array()}};
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Row& row = rows[i];
    report.json["frames"].push_back({{"index", row.index},
                                     {"image", row.id},
                                     {"problem", row.problem},
                                     {"strain", StrainJson(row.summary)}});
    if (i == kMostFrames) {
      report.text += fmt::format("... {} more frames ...\n", rows.size() - kMostFrames);
    }
    if (i >= kMostFrames) continue;
    report.text += fmt::format("Frame {} ({}):{}\n", row.index, row.id,
                               row.problem.empty() ? "" : " bad. " + row.problem);
    if (row.problem.empty()) report.text += StrainText(row.summary, header);
  }
  if (!note.empty()) {
    report.json["notes"].push_back(note);
    report.text += "Note: " + note + "\n";
  }
  if (interrupted) {
    report.text += fmt::format("Stopped by Ctrl-C: {}\n", kStopped);
    report.exit_code = 130;
  }
  report.text += fmt::format("Wrote {}.\n", output.string());
  return report;
}

fs::path AnalyseCommand::Output() const {
  const fs::path output = CheckedOutput(output_, overwrite_);
  if (fs::exists(output) && fs::equivalent(output, file_)) {
    throw InputError("The result cannot take the place of the run that it is made from.");
  }
  return output;
}

void CheckMatches(const SeriesReader& series, const std::string& file) {
  if (series.contents().matches) return;
  throw InputError(fmt::format(
      "'{}' holds no matches to work on: it was measured with sgbm or with --no-matches; measure "
      "with --matcher dic.",
      file));
}

CommandReport AnalyseCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const ResultFile file = OpenResultFile(file_);
  if (file.planar) return RunPlanar(*file.planar, common, recipe_toml);
  if (file.series) {
    CheckMatches(*file.series, file_);
    return IsRolling(*file.series) ? RunRolling(*file.series, common, recipe_toml)
                                   : RunStereo(*file.series, common, recipe_toml);
  }
  throw InputError(fmt::format("'{}' is a rig file; analyse works on runs.", file_));
}

bool IsReference(const SeriesFrame& frame, const SeriesReader& series) {
  return fmt::format("frame {}", frame.index) == series.displacement_reference();
}

// The matches of the pair that displacements count from.
ReferenceMatches ReferenceOf(const SeriesReader& series, const std::string& file) {
  if (std::optional<ReferenceMatches> reference = series.reference()) return std::move(*reference);
  // Older files hold them in that pair's own frame alone.
  for (std::int64_t i = 0; i < series.frame_count(); ++i) {
    SeriesFrame frame = series.Frame(i);
    if (IsReference(frame, series) && frame.problem.empty()) {
      return {frame.left_id, std::move(frame.match), std::move(frame.surface.status)};
    }
  }
  throw InputError(fmt::format(
      "'{}' was written by {} and does not hold the matches of the pair that displacements count "
      "from ({}): if it is a part of a run, join the parts with plumbline merge and analyse the "
      "whole; else measure again.",
      file, series.facts().software, series.displacement_reference()));
}

ReportedFrame EvaluateAgain(const SeriesFrame& before, const SeriesReader& series,
                            const PlanarField& like, SurfaceEvaluation* evaluation) {
  ReportedFrame now;
  now.frame.problem = before.problem;
  if (before.problem.empty()) {
    now.frame = IsReference(before, series)
                    ? evaluation->EvaluateReference(before.time_s)
                    : evaluation->Evaluate(FieldOf(before.match, before.surface.status, like),
                                           before.time_s);
    if (now.frame.problem.empty()) now.frame.surface.correlation = before.surface.correlation;
  }
  NameAs(before, &now.frame);
  now.motion = evaluation->Summarise(now.frame);
  now.summary.grid_points = now.motion->grid_points;
  now.summary.valid_points = now.motion->valid_points;
  return now;
}

CommandReport AnalyseCommand::RunStereo(const SeriesReader& series, const CommonOptions& common,
                                        const std::string& recipe_toml) const {
  const SurfaceEvaluationOptions options = evaluation_.Options(common.seed);
  Output();  // before work starts: whether there is a place for it
  const ReferenceMatches reference = ReferenceOf(series, file_);
  const SeriesNeighbours neighbours = NeighboursOf(series, reference.left_id);
  const Image<Eigen::Vector2f> grid = series.grid_px();
  PlanarField like;
  like.first_px = grid(0, 0).array().round().cast<int>();
  like.step_px = series.step_px();
  like.subset_px = series.subset_px();
  SurfaceEvaluation evaluation(series.rig(), FieldOf(reference.match, reference.status, like),
                               neighbours.correlation, options);
  SeriesHeader header = evaluation.Header();
  header.displacement_reference = series.displacement_reference();
  if (header.reference) header.reference->left_id = reference.left_id;
  header.recipe_toml = JoinRecipes(series.facts().recipe_toml, recipe_toml);
  header.channels = series.channels();
  header.inputs = {fs::path(file_)};
  header.inputs.insert(header.inputs.end(), neighbours.files.begin(), neighbours.files.end());

  std::vector<std::string> notes;
  if (!neighbours.note.empty()) notes.push_back(neighbours.note);
  const InterruptGuard guard;
  return WriteFrames(series, std::move(header), notes, common,
                     [&](const SeriesFrame& before, std::int64_t) {
                       return EvaluateAgain(before, series, like, &evaluation);
                     });
}

CommandReport AnalyseCommand::RunRolling(const SeriesReader& series, const CommonOptions& common,
                                         const std::string& recipe_toml) const {
  Output();
  const InterruptGuard guard;
  std::optional<RollingAnalysis> analysis =
      AnalyseRolling(series, file_, evaluation_, rolling_, common);
  if (!analysis) {
    spdlog::error("Stopped before the first frame was finished; nothing was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  SeriesHeader& header = analysis->header;
  header.recipe_toml = JoinRecipes(series.facts().recipe_toml, recipe_toml);
  header.inputs.insert(header.inputs.begin(), fs::path(file_));
  RollingRun& run = *analysis->run;
  return WriteFrames(series, std::move(header), analysis->notes, common,
                     [&](const SeriesFrame& before, std::int64_t position) {
                       return Reported(run.MeasureAgain(before, position));
                     });
}

CommandReport AnalyseCommand::WriteFrames(const SeriesReader& series, SeriesHeader header,
                                          const std::vector<std::string>& notes,
                                          const CommonOptions& common, const Again& again) const {
  const fs::path output = Output();
  SeriesWriter writer(output, header);
  MeasureReport report(output, series.frame_count(), series.rig().modes.count() > 0);
  Progress progress("analysing", series.frame_count(), common.progress());
  for (std::int64_t i = 0; i < series.frame_count(); ++i) {
    if (InterruptGuard::Requested()) {
      report.SetInterrupted(kStopped, true);
      break;
    }
    const ReportedFrame now = again(series.Frame(i), i);
    writer.Commit(now.frame);
    report.Add(now);
    progress.Advance();
  }
  if (report.frames() == 0) {
    spdlog::error("There are no frames to analyse; nothing was written.");
    return {"", {{"frames", nlohmann::json::array()}}, 3};
  }
  writer.Close();
  CommandReport result = report.Make();
  for (const std::string& note : notes) result.text += "Note: " + note + "\n";
  if (!notes.empty()) result.json["notes"] = notes;
  return result;
}

CommandReport AnalyseCommand::RunPlanar(const PlanarSeriesReader& series,
                                        const CommonOptions& common,
                                        const std::string& recipe_toml) {
  const PlanarStrainOptions options = evaluation_.strain().Options();
  if (options.window_points == 1 &&
      (series.header().order < 1 || !series.header().contents.gradient_covariance)) {
    throw InputError(fmt::format(
        "A strain window of 1 point needs the covariances of the subsets' gradients, which '{}' "
        "does not hold; correlate with --gradient-covariance (and --order 1 or 2), or take a "
        "window of 3 points or more.",
        file_));
  }
  const fs::path output = Output();
  const SeriesNeighbours neighbours = NeighboursOf(series.header(), series.facts().inputs_json);
  PlanarSeriesHeader header = series.header();
  header.contents.strain = true;
  header.strain_measure = plumbline::Name(options.measure);
  header.window_points = options.window_points;
  header.vsg_px = (options.window_points - 1) * header.step_px + header.subset_px;
  header.recipe_toml = JoinRecipes(header.recipe_toml, recipe_toml);
  header.inputs = {fs::path(file_)};
  header.inputs.insert(header.inputs.end(), neighbours.files.begin(), neighbours.files.end());

  const InterruptGuard guard;
  PlanarSeriesWriter writer(output, header);
  Progress progress("strain", series.frame_count(), common.progress());
  std::vector<Row> rows;
  for (std::int64_t i = 0; i < series.frame_count() && !InterruptGuard::Requested(); ++i) {
    PlanarSeriesFrame frame = series.Frame(i);
    if (frame.problem.empty()) {
      frame.strain = RecordOf(ComputePlanarStrain(frame.field, neighbours.correlation, options));
    }
    writer.Commit(frame);
    rows.push_back({frame.index, frame.id, frame.problem, Summarise(frame)});
    progress.Advance();
  }
  if (rows.empty()) {
    spdlog::error("There are no frames to analyse; nothing was written.");
    return {"", {{"frames", nlohmann::json::array()}}, 3};
  }
  const bool interrupted = static_cast<std::int64_t>(rows.size()) < series.frame_count();
  writer.Close();
  return Report(output, header, neighbours.note, rows, interrupted);
}

}  // namespace

std::unique_ptr<Command> MakeAnalyseCommand() { return std::make_unique<AnalyseCommand>(); }

}  // namespace plumbline::internal
