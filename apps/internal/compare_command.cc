#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <numbers>

#include "apps/internal/command.h"
#include "apps/internal/result_file.h"
#include "apps/internal/simulate_options.h"
#include "apps/run_comparison.h"
#include "apps/truth_comparison.h"
#include "calib/error.h"
#include "io/height_table.h"
#include "io/section_table.h"
#include "io/series_points.h"
#include "io/series_reader.h"

namespace plumbline::internal {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

nlohmann::json Number(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

nlohmann::json JsonOf(std::int64_t index, const TruthComparison& c) {
  nlohmann::json json = {{"index", index},
                         {"points", c.points},
                         {"unfounded_points", c.unfounded},
                         {"rms_distance_mm", Number(c.rms_distance_mm)},
                         {"rms_shape_mm", Number(c.rms_shape_mm)},
                         {"rms_height_mm", Number(c.rms_height_mm)},
                         {"median_height_error_mm", Number(c.median_height_error_mm)},
                         {"median_sigma_random_mm", Number(c.median_sigma_random_mm)},
                         {"median_sigma_calibration_mm", Number(c.median_sigma_calibration_mm)},
                         {"within_one_sigma", Number(c.within_one_sigma)},
                         {"within_two_sigma", Number(c.within_two_sigma)}};
  for (int k = 0; k < 3; ++k) {
    json["rms_displacement_mm"].push_back(Number(c.rms_displacement_mm[k]));
    json["median_displacement_error_mm"].push_back(Number(c.median_displacement_error_mm[k]));
    json["within_two_sigma_displacement"].push_back(Number(c.within_two_sigma_displacement[k]));
  }
  for (int k = 0; k < 2; ++k) {
    json["tilt_error_deg"].push_back(Number(c.tilt_error_rad[k] * kDegrees));
    json["sigma_tilt_deg"].push_back(Number(c.sigma_tilt_rad[k] * kDegrees));
  }
  return json;
}

std::string RowOf(std::int64_t index, const TruthComparison& c) {
  std::string row = fmt::format("{:>5} {:>8}", index, c.points);
  if (c.points == 0) {
    row += "  no points";
  } else {
    row +=
        fmt::format(" {:>9.3f} {:>8.3f} {:>8.3f} {:>8.4f} {:>8.4f} {:>8.4f} {:>6.1f} % {:>5.1f} %",
                    c.rms_distance_mm, c.rms_shape_mm, c.rms_height_mm, c.median_height_error_mm,
                    c.median_sigma_random_mm, c.median_sigma_calibration_mm,
                    100 * c.within_one_sigma, 100 * c.within_two_sigma);
  }
  if (std::isfinite(c.tilt_error_rad[0])) {
    row += fmt::format("  {:>7.4f} +- {:.4f} {:>8.4f} +- {:.4f}", c.tilt_error_rad[0] * kDegrees,
                       c.sigma_tilt_rad[0] * kDegrees, c.tilt_error_rad[1] * kDegrees,
                       c.sigma_tilt_rad[1] * kDegrees);
  }
  row += "\n";
  if (std::isfinite(c.rms_displacement_mm[0])) {
    row += fmt::format(
        "      displacement from the wheel, rms (median), mm; within 2 sigma: towards the axis "
        "{:.4f} ({:.4f}), {:.1f} %; around it {:.4f} ({:.4f}), {:.1f} %; along it {:.4f} ({:.4f}), "
        "{:.1f} %\n",
        c.rms_displacement_mm[0], c.median_displacement_error_mm[0],
        100 * c.within_two_sigma_displacement[0], c.rms_displacement_mm[1],
        c.median_displacement_error_mm[1], 100 * c.within_two_sigma_displacement[1],
        c.rms_displacement_mm[2], c.median_displacement_error_mm[2],
        100 * c.within_two_sigma_displacement[2]);
  }
  return row;
}

constexpr const char* kHead =
    "               error, mm                            sigma, mm         points within   tilt "
    "error "
    "and sigma, deg\n"
    "frame   points  distance    shape   height   median   random calibrn.  1 sigma 2 sigma   "
    "about "
    "x           about y\n";
constexpr const char* kLegend =
    "distance  rms distance of the measured points from the true ones, as measured\n"
    "shape     the same after the best rigid motion: where the rig's own frame lies is known no "
    "better\n"
    "height    rms of its part along z; median: of its size, which a few wrong points do not "
    "change\n"
    "sigma     what was claimed for the height, median: from noise, and from the calibration\n"
    "within    share of the points whose height is within one and two sigmas (both parts)\n"
    "tilt      of the plane found against the true ground\n";

constexpr const char* kRunsHead =
    "                      difference of heights, mm           sigma, mm        within   between\n"
    "frame other   places    mean     rms  median   shape  random calibrn. 2 sigma   the planes\n";
constexpr const char* kRunsLegend =
    "difference  of RUN's heights above the ground less the other's, at places that both see;\n"
    "            median: of its size; shape: rms about the plane through the differences\n"
    "sigma       claimed for a difference, median; the calibrations' as if independent\n"
    "within      share of the places whose difference is within two sigmas (both parts)\n"
    "planes      how far the ground planes lie apart below the axis, mm, and how they are turned\n"
    "            against each other about x and y of the ground, degrees, with one sigma\n";

std::string WithSigma(double value, double random, double calibration, int digits) {
  if (!std::isfinite(value)) return "-";
  const double sigma = std::hypot(random, std::isfinite(calibration) ? calibration : 0);
  return fmt::format("{:.{}f} +- {:.{}f}", value, digits, sigma, digits);
}

std::string RowOf(const SeriesFrame& run, const SeriesFrame& other, const HeightComparison& c) {
  std::string row = fmt::format("{:>5} {:>5} {:>8}", run.index, other.index, c.difference.count);
  if (c.difference.count == 0) return row + "  no places that both see\n";
  row += fmt::format(" {:>7.3f} {:>7.3f} {:>7.4f} {:>7.4f} {:>7.4f} {:>8.4f} {:>5.1f} %",
                     c.difference.mean_mm, c.difference.rms_mm, c.median_mm, c.rms_from_plane_mm,
                     c.median_sigma_random_mm, c.median_sigma_calibration_mm,
                     100 * c.within_two_sigma);
  row += "  " + WithSigma(c.offset_mm, c.sigma_random_offset_mm, c.sigma_calibration_offset_mm, 4);
  for (int k = 0; k < 2; ++k) {
    row += "  " + WithSigma(kDegrees * c.tilt_rad[k], kDegrees * c.sigma_random_tilt_rad[k],
                            kDegrees * c.sigma_calibration_tilt_rad[k], 4);
  }
  return row + "\n";
}

nlohmann::json JsonOf(const SeriesFrame& run, const SeriesFrame& other, double ahead_mm,
                      const HeightComparison& c) {
  nlohmann::json json = {{"index", run.index},
                         {"other_index", other.index},
                         {"ahead_mm", Number(ahead_mm)},
                         {"places", c.difference.count},
                         {"area_mm2", Number(c.area_mm2)},
                         {"length_mm", Number(c.length_mm)},
                         {"bias_mm", Number(c.difference.mean_mm)},
                         {"rms_mm", Number(c.difference.rms_mm)},
                         {"median_mm", Number(c.median_mm)},
                         {"rms_from_plane_mm", Number(c.rms_from_plane_mm)},
                         {"median_sigma_random_mm", Number(c.median_sigma_random_mm)},
                         {"median_sigma_calibration_mm", Number(c.median_sigma_calibration_mm)},
                         {"within_two_sigma", Number(c.within_two_sigma)},
                         {"offset_mm", Number(c.offset_mm)},
                         {"sigma_random_offset_mm", Number(c.sigma_random_offset_mm)},
                         {"sigma_calibration_offset_mm", Number(c.sigma_calibration_offset_mm)}};
  for (int k = 0; k < 2; ++k) {
    json["tilt_deg"].push_back(Number(kDegrees * c.tilt_rad[k]));
    json["sigma_random_tilt_deg"].push_back(Number(kDegrees * c.sigma_random_tilt_rad[k]));
    json["sigma_calibration_tilt_deg"].push_back(
        Number(kDegrees * c.sigma_calibration_tilt_rad[k]));
  }
  return json;
}

std::vector<std::int64_t> IndicesOf(const SeriesReader& series) {
  std::vector<std::int64_t> indices;
  for (std::int64_t i = 0; i < series.frame_count(); ++i) indices.push_back(series.Frame(i).index);
  return indices;
}

// Why a frame cannot be told in a frame that it has in common with others; empty: it can.
std::string ProblemOf(const SeriesFrame& frame) {
  if (!frame.problem.empty()) return frame.problem;
  if (frame.surface.frame == SurfaceFrame::kGround) return {};
  const std::string why = frame.ground.problem.empty() ? "" : ": " + frame.ground.problem;
  return "its positions are not in a ground frame" + why;
}

class CompareCommand : public Command {
 public:
  std::string Name() const override { return "compare"; }
  std::string Summary() const override {
    return "Hold a measurement against another one, or against the exact truth of the virtual rig.";
  }
  std::string Footer() const override {
    return "Examples:\n"
           "  plumbline compare run.h5 sim                    against what plumbline simulate "
           "wrote\n"
           "  plumbline compare today.h5 before.h5            frame by frame, in the ground frame\n"
           "  plumbline compare today.h5 before.h5 --section y=0 --shift 35 -o differences.csv\n"
           "With --shift, frames are compared in which the wheel stands at the same place of the "
           "ground.";
  }
  void Declare(OptionTable& options) override {
    options.Add({.name = "RUN",
                 .help = "what plumbline measure wrote",
                 .required = true,
                 .positional = true},
                &run_);
    options.Add({.name = "WITH",
                 .help = "another run, or the folder that plumbline simulate wrote",
                 .required = true,
                 .positional = true},
                &with_);
    options.Add({.name = "frame", .help = "which frame of RUN, from 0; auto: all", .min = 0},
                &frame_);
    options.Add({.name = "other-frame",
                 .help = "the frame of the other run that --frame is compared with, from 0; auto: "
                         "that of the same number in its recording, or by --shift",
                 .min = 0},
                &other_frame_);
    options.Add(
        {.name = "shift",
         .help = "frames are paired by the way over the ground, not by number: how far the "
                 "other wheel goes from its first frame to where RUN's first frame is; an "
                 "obstacle at travel + x in both tells it (plumbline export --format bumps)",
         .unit = "mm"},
        &shift_mm_);
    options.Add({.name = "most-apart",
                 .help = "with --shift: frames whose wheels are further apart are no pair",
                 .unit = "mm",
                 .min = 0},
                &most_apart_mm_);
    options.Add({.name = "section",
                 .help = "only along the line x=150 (lateral) or y=0 (longitudinal), mm in the "
                         "ground frame; empty: all that both see"},
                &section_);
    options.Add({.name = "step",
                 .help = "between the places at which the heights of two runs are compared",
                 .unit = "mm",
                 .min = 0.1,
                 .max = 1e3},
                &step_mm_);
    options.Add(
        {.name = "output",
         .help = "a csv of all those places, with both heights, their difference and its "
                 "sigmas; of several pairs, each gets a file with the number of RUN's frame. "
                 "Empty: none",
         .unit = "FILE",
         .short_name = "o"},
        &output_);
  }

  CommandReport Run(const CommonOptions& common, const std::string&) override {
    if (std::filesystem::is_regular_file(with_)) return CompareRuns(common);
    if (frame_ || other_frame_ || shift_mm_ || !section_.empty() || !output_.empty()) {
      throw UsageError(
          "--frame, --other-frame, --shift, --section and --output are for two runs; against the "
          "truth of a folder all frames are compared.");
    }
    return CompareWithFolder();
  }

 private:
  CommandReport CompareWithFolder() const;
  CommandReport CompareRuns(const CommonOptions& common) const;
  std::vector<FramePair> Pairs(const SeriesReader& run, const SeriesReader& other) const;

  std::string run_, with_, section_, output_;
  std::optional<int> frame_, other_frame_;
  std::optional<double> shift_mm_;
  double most_apart_mm_ = 5, step_mm_ = 2;
};

CommandReport CompareCommand::CompareWithFolder() const {
  const VirtualRig rig = ReopenVirtualRig(with_);
  const std::vector<int> recorded = rig.Recorded();
  const SeriesReader run(run_);
  if (run.rig().left.size() != rig.scenario().rig.left.size()) {
    throw InputError(
        fmt::format("'{}' was not measured from '{}': its images have another size.", run_, with_));
  }
  if (run.grid_points() == "material" && !run.contents().matches) {
    throw InputError(fmt::format(
        "'{}' follows material points and does not say where they are in its images: measure "
        "without --no-matches.",
        run_));
  }
  const Image<Eigen::Vector2f> grid_px = run.grid_px();
  CommandReport report;
  report.text = kHead;
  for (std::int64_t i = 0; i < run.frame_count(); ++i) {
    const SeriesFrame frame = run.Frame(i);
    if (frame.index < 0 || frame.index >= static_cast<std::int64_t>(recorded.size())) {
      throw InputError(
          fmt::format("'{}' holds a frame {}, and '{}' only {}: they do not belong "
                      "together.",
                      run_, frame.index, with_, recorded.size()));
    }
    const auto truth = rig.Truth(recorded[static_cast<std::size_t>(frame.index)]);
    const TruthComparison comparison = CompareWithTruth(frame, grid_px, *truth);
    report.text += RowOf(frame.index, comparison);
    report.json["frames"].push_back(JsonOf(frame.index, comparison));
  }
  report.text += kLegend;
  return report;
}

std::vector<FramePair> CompareCommand::Pairs(const SeriesReader& run,
                                             const SeriesReader& other) const {
  const auto check = [](const std::optional<int>& frame, const char* option,
                        const std::string& file, const SeriesReader& series) {
    if (!frame || *frame < series.frame_count()) return;
    throw UsageError(fmt::format("--{} {}: '{}' has {} frames, counted from 0.", option, *frame,
                                 file, series.frame_count()));
  };
  check(frame_, "frame", run_, run);
  check(other_frame_, "other-frame", with_, other);
  if (other_frame_) {
    if (!frame_ || shift_mm_) {
      throw UsageError("--other-frame goes with --frame, and without --shift.");
    }
    return {{*frame_, *other_frame_, HeightComparison::kNone}};
  }
  std::vector<FramePair> pairs =
      shift_mm_ ? PairByTravel(TravelOf(run), TravelOf(other), *shift_mm_, most_apart_mm_)
                : PairByIndex(IndicesOf(run), IndicesOf(other));
  if (frame_) std::erase_if(pairs, [&](const FramePair& pair) { return pair.run != *frame_; });
  if (!pairs.empty()) return pairs;
  if (!shift_mm_) {
    throw InputError(
        fmt::format("No frame of '{}' has the number of one of '{}': name a pair with --frame and "
                    "--other-frame, or give --shift.",
                    run_, with_));
  }
  throw InputError(
      fmt::format("In no frame of '{}' the wheel is within {:g} mm of where it is in one of '{}' "
                  "shifted by {:g} mm, or its speed over the ground is not known.",
                  run_, most_apart_mm_, with_, *shift_mm_));
}

CommandReport CompareCommand::CompareRuns(const CommonOptions& common) const {
  RunComparisonOptions options;
  options.step_mm = step_mm_;
  if (!section_.empty()) options.section = ParseSection(section_);
  const SeriesReader run(run_), other(with_);
  const std::vector<FramePair> pairs = Pairs(run, other);
  const NeighbourCorrelation neighbours = NeighboursOf(run), others = NeighboursOf(other);
  CommandReport report;
  report.text = kRunsHead;
  report.json["frames"] = nlohmann::json::array();
  int bad = 0;
  std::string problem;
  Progress progress("comparing", std::ssize(pairs), common.progress());
  for (const FramePair& pair : pairs) {
    const SeriesFrame a = run.Frame(pair.run), b = other.Frame(pair.other);
    progress.Advance();
    const std::string of_a = ProblemOf(a), of_b = ProblemOf(b);
    if (!of_a.empty() || !of_b.empty()) {
      ++bad;
      if (problem.empty()) {
        problem = of_a.empty() ? fmt::format("frame {} of '{}': {}", pair.other, with_, of_b)
                               : fmt::format("frame {} of '{}': {}", pair.run, run_, of_a);
      }
      continue;
    }
    const HeightComparison comparison = CompareFrames(a, neighbours, b, others, options);
    report.text += RowOf(a, b, comparison);
    report.json["frames"].push_back(JsonOf(a, b, pair.ahead_mm, comparison));
    if (output_.empty()) continue;
    ExportHeights(
        pairs.size() > 1 ? NumberedFile(output_, pair.run) : std::filesystem::path(output_),
        comparison.run, comparison.other, comparison.difference);
  }
  if (report.json["frames"].empty()) {
    throw InputError(fmt::format("There is nothing to compare: {}.", problem));
  }
  report.text += kRunsLegend;
  if (bad > 0) {
    report.text += fmt::format("{} pairs were left out; the first one: {}.\n", bad, problem);
  }
  report.json["pairs_left_out"] = bad;
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeCompareCommand() { return std::make_unique<CompareCommand>(); }

}  // namespace plumbline::internal
