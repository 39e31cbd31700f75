#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>

#include "apps/internal/command.h"
#include "apps/internal/measure_report.h"
#include "apps/interrupt.h"
#include "apps/pipeline.h"
#include "apps/rig_input.h"
#include "calib/error.h"
#include "io/image_source.h"
#include "io/series_writer.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// Images of a wrong size are refused as long as nothing was measured: then the rig is not theirs.
// Later on they are bad frames like others.
MeasuredFrame MeasureOne(const StereoMeasurement& measurement, const StereoFrame& pair,
                         bool under_way) {
  try {
    return measurement.Measure(pair);
  } catch (const InputError& error) {
    if (!under_way) throw;
    StereoFrame bad = pair;
    bad.problem = error.what();
    return measurement.Measure(bad);
  }
}

class MeasureCommand : public Command {
 public:
  std::string Name() const override { return "measure"; }
  std::string Summary() const override {
    return "Measure the surface in every stereo pair, with error bars, into one HDF5 file.";
  }
  std::string Footer() const override {
    return "Example:\n"
           "  plumbline measure --rig rig.h5 --left 'left/*.png' --right 'right/*.png' -o run.h5\n"
           "Open the result with plumbline info run.h5, with h5py or MATLAB's h5read, or as points "
           "after\n  plumbline export run.h5 --format ply -o run.ply";
  }
  void Declare(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  void DeclareMatching(OptionTable& options);
  void DeclareGround(OptionTable& options);
  MeasureOptions Options(std::uint64_t seed) const;
  void MeasureAll(const StereoMeasurement& measurement, ImageSource& source, SeriesWriter& writer,
                  ProgressStyle style, MeasureReport& report) const;

  std::string rig_, left_, right_, output_ = "run.h5";
  double rig_length_unit_mm_ = 1;
  std::string rig_image_size_;
  std::string matcher_ = "sgbm", frames_, roi_, mask_, timestamps_, rectification_ = "auto";
  std::string frame_ = "ground";
  std::optional<double> frames_per_second_;
  bool overwrite_ = false;
  MeasureOptions options_;
};

void MeasureCommand::Declare(OptionTable& options) {
  options.Add(
      {.name = "rig",
       .help = "the calibrated rig: rig.h5, left.cameramodel,right.cameramodel, or a stereo "
               "calibration of OpenCV, DICe, VIC-3D or MatchID",
       .unit = "FILE",
       .required = true},
      &rig_);
  options.Add(
      {.name = "left",
       .help = "images of the left camera: a pattern in quotes, a folder, an image or a video",
       .unit = "FILES",
       .required = true},
      &left_);
  options.Add(
      {.name = "right", .help = "those of the right camera", .unit = "FILES", .required = true},
      &right_);
  options.Add(
      {.name = "output", .help = "where the result goes", .unit = "FILE", .short_name = "o"},
      &output_);
  options.Add({.name = "overwrite", .help = "replace the output file if it is there"}, &overwrite_);
  options.Add({.name = "frames",
               .help = "which pairs, as start:stop:step counted from 0; empty: all",
               .unit = "A:B:C"},
              &frames_);
  options.Add({.name = "fps",
               .help = "frames a second, for images without a clock of their own",
               .unit = "1/s",
               .min = 1e-6},
              &frames_per_second_);
  options.Add({.name = "timestamps",
               .help = "a text table with the time of each frame in its last column",
               .unit = "FILE"},
              &timestamps_);
  options.Add({.name = "roi",
               .help = "region of the left image to measure; empty: all of it",
               .unit = "X,Y,W,H px"},
              &roi_);
  options.Add(
      {.name = "mask",
       .help = "image of the left camera's size: 0 is left out, all else (1 or 255) measured",
       .unit = "FILE"},
      &mask_);
  DeclareMatching(options);
  DeclareGround(options);
  options.Add({.name = "rig-length-unit",
               .help = "how many mm the rig file's unit of length is, for OpenCV files in metres: "
                       "1000",
               .unit = "mm",
               .min = 1e-6},
              &rig_length_unit_mm_);
  options.Add({.name = "rig-image-size",
               .help = "image size, for rig files of other programs that do not hold it",
               .unit = "WxH px"},
              &rig_image_size_);
}

void MeasureCommand::DeclareMatching(OptionTable& options) {
  options.Add({.name = "matcher", .help = "how points are matched", .choices = {"sgbm"}},
              &matcher_);
  options.Add({.name = "step",
               .help = "distance between points in the rectified left image",
               .unit = "px",
               .min = 1,
               .max = 10000},
              &options_.step_px);
  options.Add(
      {.name = "min-distance",
       .help = "nearest surface from the left camera; auto: found from the images, else near the "
               "calibration board's distance",
       .unit = "mm",
       .min = 1e-3},
      &options_.min_distance_mm);
  options.Add({.name = "max-distance",
               .help = "farthest surface from the left camera",
               .unit = "mm",
               .min = 1e-3},
              &options_.max_distance_mm);
  options.Add({.name = "block",
               .help = "side of the matcher's block, odd; 0: the matcher's own",
               .unit = "px",
               .min = 0,
               .max = 255},
              &options_.disparity.block_px);
  options.Add({.name = "uniqueness",
               .help = "by how much the best match must beat the second best",
               .unit = "%",
               .min = 0,
               .max = 100},
              &options_.disparity.uniqueness_percent);
  options.Add({.name = "left-right-tolerance",
               .help = "by how much the matches from left and from right may differ",
               .unit = "px",
               .min = 0},
              &options_.disparity.left_right_tolerance_px);
  options.Add({.name = "rectification",
               .help = "how the images are rectified; auto: pinhole up to 90 degrees of view",
               .choices = {"auto", "pinhole", "lat-lon"}},
              &rectification_);
  options.Add({.name = "resolution",
               .help = "rectified pixels a pixel of the image",
               .unit = "px",
               .min = 0.05,
               .max = 8},
              &options_.rectification.pixels_per_input_pixel);
}

void MeasureCommand::DeclareGround(OptionTable& options) {
  options.Add({.name = "frame",
               .help = "frame of the positions: ground (z up from the plane found; rig where none "
                       "holds) or rig (the left camera)",
               .choices = {"ground", "rig"}},
              &frame_);
  options.Add({.name = "plane-threshold",
               .help = "distance from the plane up to which a point belongs to it; 0: from the "
                       "points' own sigmas and scatter",
               .unit = "mm",
               .min = 0},
              &options_.ground.inlier_threshold_mm);
  options.Add({.name = "plane-min-share",
               .help = "share of the points that a plane must hold",
               .min = 0.01,
               .max = 1},
              &options_.ground.min_inlier_fraction);
  options.Add({.name = "point-covariance", .help = "also store the 3x3 covariance of each point"},
              &options_.point_covariance);
}

MeasureOptions MeasureCommand::Options(std::uint64_t seed) const {
  MeasureOptions options = options_;
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  options.rectification.kind = rectification_ == "pinhole"   ? RectificationKind::kPinhole
                               : rectification_ == "lat-lon" ? RectificationKind::kLatLon
                                                             : RectificationKind::kAuto;
  options.turn_into_ground_frame = frame_ == "ground";
  options.ground.seed = seed;
  options.Check();
  return options;
}

void MeasureCommand::MeasureAll(const StereoMeasurement& measurement, ImageSource& source,
                                SeriesWriter& writer, ProgressStyle style,
                                MeasureReport& report) const {
  Progress progress("measuring", source.DeclaredCount(), style);
  while (!InterruptGuard::Requested()) {
    const std::optional<StereoFrame> pair = source.Next();
    if (!pair) return;
    const MeasuredFrame measured = MeasureOne(measurement, *pair, report.measured() > 0);
    writer.Commit(measured.frame);
    if (!measured.frame.problem.empty()) {
      progress.Note(fmt::format("Frame {} is marked as bad: {}", measured.frame.index,
                                measured.frame.problem));
    }
    report.Add(measured);
    progress.Advance();
  }
  report.SetInterrupted();
}

CommandReport MeasureCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  MeasureOptions options = Options(common.seed);
  const fs::path output = fs::absolute(output_);
  if (fs::exists(output) && !overwrite_) {
    throw InputError(fmt::format(
        "'{}' is there already; choose another name with -o, or say --overwrite.", output_));
  }
  if (!fs::is_directory(output.parent_path())) {
    throw EnvironmentError(fmt::format("There is no folder '{}' to write into; make it first.",
                                       output.parent_path().string()));
  }
  ForeignCalibrationOptions foreign;
  foreign.length_unit_mm = rig_length_unit_mm_;
  if (!rig_image_size_.empty()) foreign.image_size = ParseImageSize(rig_image_size_);
  const RigInput rig = OpenRig(rig_, foreign);
  options.likely_distance_mm = rig.working_distance_mm;
  for (const std::string& note : rig.notes) spdlog::info("Note: {}", note);
  if (rig.rig.modes.count() == 0) {
    spdlog::info(
        "Note: this calibration does not say how sure it is, so the calibration part of all "
        "uncertainties is unknown (NaN). Calibrate with plumbline calibrate to have it.");
  }
  ImageSourceOptions source_options;
  source_options.frames = frames_;
  source_options.frames_per_second = frames_per_second_;
  source_options.timestamps_csv = timestamps_;
  const auto source = OpenImageSource(left_, right_, source_options);
  const StereoMeasurement measurement(rig.rig, options);

  SeriesHeader header{.rig = rig.rig,
                      .grid_px = measurement.grid_px(),
                      .step_px = options.step_px,
                      .subset_px = measurement.window_px(),
                      .recipe_toml = recipe_toml,
                      .inputs = source->Files(),
                      .rig_extras = {},
                      .contents = {.covariance = options.point_covariance}};
  for (const std::string& file : rig.files) header.inputs.emplace_back(file);
  if (!mask_.empty()) header.inputs.emplace_back(mask_);

  const InterruptGuard guard;
  MeasureReport report(output, source->DeclaredCount(), rig.rig.modes.count() > 0);
  SeriesWriter writer(output, header);
  MeasureAll(measurement, *source, writer, common.progress(), report);
  const std::vector<std::string> notes = source->Notes();
  for (const std::string& note : notes) spdlog::info("Note: {}", note);
  if (report.frames() == 0) {
    spdlog::error(report.interrupted() ? "Stopped before the first frame was finished; nothing was "
                                         "written."
                                       : "There are no frames to measure; nothing was written.");
    return {"", {{"interrupted", report.interrupted()}}, report.interrupted() ? 130 : 3};
  }
  writer.Close();
  CommandReport result = report.Make();
  result.json["notes"] = notes;
  return result;
}

}  // namespace

std::unique_ptr<Command> MakeMeasureCommand() { return std::make_unique<MeasureCommand>(); }

}  // namespace plumbline::internal
