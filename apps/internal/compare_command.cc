#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "apps/internal/command.h"
#include "apps/internal/simulate_options.h"
#include "apps/truth_comparison.h"
#include "calib/error.h"
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
  return row + "\n";
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

class CompareCommand : public Command {
 public:
  std::string Name() const override { return "compare"; }
  std::string Summary() const override {
    return "Hold a measurement of the virtual rig against its exact truth.";
  }
  void Declare(OptionTable& options) override {
    options.Add({.name = "RUN",
                 .help = "what plumbline measure wrote",
                 .required = true,
                 .positional = true},
                &run_);
    options.Add({.name = "FOLDER",
                 .help = "the folder that plumbline simulate wrote",
                 .required = true,
                 .positional = true},
                &folder_);
  }

  CommandReport Run(const CommonOptions&, const std::string&) override {
    const VirtualRig rig = ReopenVirtualRig(folder_);
    const std::vector<int> recorded = rig.Recorded();
    const SeriesReader run(run_);
    if (run.rig().left.size() != rig.scenario().rig.left.size()) {
      throw InputError(fmt::format("'{}' was not measured from '{}': its images have another size.",
                                   run_, folder_));
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
                        run_, frame.index, folder_, recorded.size()));
      }
      const auto truth = rig.Truth(recorded[static_cast<std::size_t>(frame.index)]);
      const TruthComparison comparison = CompareWithTruth(frame, grid_px, *truth);
      report.text += RowOf(frame.index, comparison);
      report.json["frames"].push_back(JsonOf(frame.index, comparison));
    }
    report.text += kLegend;
    return report;
  }

 private:
  std::string run_, folder_;
};

}  // namespace

std::unique_ptr<Command> MakeCompareCommand() { return std::make_unique<CompareCommand>(); }

}  // namespace plumbline::internal
