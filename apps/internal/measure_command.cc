#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>

#include "apps/internal/channel_options.h"
#include "apps/internal/command.h"
#include "apps/internal/contact_options.h"
#include "apps/internal/delay_options.h"
#include "apps/internal/measure_flow.h"
#include "apps/internal/measure_report.h"
#include "apps/internal/recording_options.h"
#include "apps/internal/result_file.h"
#include "apps/internal/rolling_options.h"
#include "apps/internal/run_output.h"
#include "apps/internal/shard_option.h"
#include "apps/internal/stereo_options.h"
#include "apps/internal/wheel_lean.h"
#include "apps/interrupt.h"
#include "apps/pipeline.h"
#include "apps/rig_input.h"
#include "apps/rolling_run.h"
#include "apps/stereo_run.h"
#include "calib/error.h"
#include "io/image_source.h"
#include "io/series_shard.h"
#include "io/series_writer.h"
#include "track/right_flow.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// What a matcher has to do in a run.
struct Measurement {
  SeriesHeader header;  // but for the recipe and the inputs
  std::function<ReportedFrame(const StereoFrame&, std::int64_t)> measure;
  // The first pair to measure so that the one at this place comes out right.
  std::function<std::int64_t(std::int64_t)> first_to_measure;
  std::int64_t block_frames = 1;  // between places where a recording can be cut
  std::vector<std::string> notes;
  std::vector<fs::path> inputs;                    // that are read besides those of the frames
  nlohmann::json more = nlohmann::json::object();  // to report beside the frames
};

// Images of a wrong size are refused as long as nothing was measured: then the rig is not theirs.
// Later on they are bad frames like others.
class SizeGuard {
 public:
  template <typename Measure>
  auto operator()(const StereoFrame& pair, const Measure& measure) {
    try {
      auto result = measure(pair);
      under_way_ = under_way_ || result.frame.problem.empty();
      return result;
    } catch (const InputError& error) {
      if (!under_way_) throw;
      StereoFrame bad = pair;
      bad.problem = error.what();
      return measure(bad);
    }
  }

 private:
  bool under_way_ = false;
};

class MeasureCommand : public Command {
 public:
  std::string Name() const override { return "measure"; }
  std::string Summary() const override {
    return "Measure the surface in every stereo pair, with error bars, into one HDF5 file.";
  }
  std::string Footer() const override {
    return "Examples:\n"
           "  plumbline measure --rig rig.h5 --left 'left/*.png' --right 'right/*.png' -o run.h5\n"
           "  plumbline measure --matcher dic --rig rig.h5 --left left.mkv --right right.mkv\n"
           "  plumbline measure --reference wheel.h5 --left rolling/left --right rolling/right\n"
           "The first gives the shape in each pair; the second follows the material (stereo-DIC): "
           "shape, displacement and strain since the first pair; the third measures a rolling tyre "
           "against its undeformed wheel.\n"
           "Open the result with plumbline info run.h5, with h5py or MATLAB's h5read, or as points "
           "after\n  plumbline export run.h5 --format ply -o run.ply";
  }
  void Declare(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  void DeclareRun(OptionTable& options);
  void DeclareSgbm(OptionTable& options);
  MeasureOptions SgbmOptions(std::uint64_t seed) const;
  Measurement Sgbm(const RigInput& rig, std::uint64_t seed) const;
  Measurement Dic(const RigInput& rig, std::uint64_t seed) const;
  std::optional<Measurement> Rolling(const CommonOptions& common,
                                     std::vector<Channel>* channels) const;
  StereoRunOptions DicOptions(std::uint64_t seed, int bits) const;
  void CheckRolling() const;
  WheelReference Wheel() const;
  RigInput Rig() const;
  StereoFrame ReferencePair(std::vector<fs::path>* files) const;

  RecordingOptionSet recording_;
  std::string output_ = "run.h5";
  std::string matcher_ = "auto", roi_, mask_, rectification_ = "auto", shard_;
  ChannelOptionSet channels_;
  std::optional<int> step_px_, reference_frame_;
  bool overwrite_ = false, resume_ = false;
  MeasureOptions sgbm_;
  StereoOptionSet dic_;
  RollingOptionSet rolling_;
  ContactOptionSet contact_;
  DelayOptionSet delay_;
  EvaluationOptionSet evaluation_;
};

void MeasureCommand::Declare(OptionTable& options) {
  recording_.Declare(options, false);
  rolling_.Declare(options);
  contact_.Declare(options);
  delay_.Declare(options, "as the wheel's file says", true);
  options.Add(
      {.name = "output", .help = "where the result goes", .unit = "FILE", .short_name = "o"},
      &output_);
  options.Add({.name = "overwrite", .help = "replace the output file if it is there"}, &overwrite_);
  DeclareRun(options);
  options.Add({.name = "roi",
               .help = "region of the left image to measure; empty: all of it",
               .unit = "X,Y,W,H px"},
              &roi_);
  options.Add(
      {.name = "mask",
       .help = "image of the left camera's size: 0 is left out, all else (1 or 255) measured",
       .unit = "FILE"},
      &mask_);
  options.Add(
      {.name = "matcher",
       .help = "sgbm: every pair on its own, in the rectified images; dic: material points "
               "are followed by correlation in the raw images; auto: sgbm, with --reference "
               "dic",
       .choices = {"auto", "sgbm", "dic"}},
      &matcher_);
  options.Add({.name = "step",
               .help = "distance between points in the left image (for sgbm the rectified one); "
                       "auto: 1 for sgbm, 8 for dic",
               .unit = "px",
               .min = 1,
               .max = 10000},
              &step_px_);
  options.Add({.name = "reference-frame",
               .help = "the pair that displacements count from, counted from 0; auto: the first "
                       "good one of those measured",
               .min = 0,
               .max = 2e9},
              &reference_frame_);
  dic_.Declare(options);
  DeclareSgbm(options);
  evaluation_.DeclareGround(options);
  evaluation_.Declare(options);
  recording_.DeclareForeign(options);
}

void MeasureCommand::DeclareRun(OptionTable& options) {
  recording_.DeclareFrames(options);
  channels_.Declare(options);
  options.Add(
      {.name = "resume",
       .help = "go on with a run that was broken off; one that is finished is left as it is"},
      &resume_);
  options.Add({.name = "shard",
               .help = "measure one part of the recording alone, as 2/4 the second of four; "
                       "plumbline merge joins them",
               .unit = "I/N"},
              &shard_);
}

void MeasureCommand::DeclareSgbm(OptionTable& options) {
  options.Add(
      {.name = "min-distance",
       .help = "nearest surface from the left camera; auto: found from the images, else near the "
               "calibration board's distance",
       .unit = "mm",
       .min = 1e-3},
      &sgbm_.min_distance_mm);
  options.Add({.name = "max-distance",
               .help = "farthest surface from the left camera",
               .unit = "mm",
               .min = 1e-3},
              &sgbm_.max_distance_mm);
  options.Add({.name = "block",
               .help = "side of the matcher's block, odd; 0: the matcher's own",
               .unit = "px",
               .min = 0,
               .max = 255},
              &sgbm_.disparity.block_px);
  options.Add({.name = "uniqueness",
               .help = "by how much the best match must beat the second best",
               .unit = "%",
               .min = 0,
               .max = 100},
              &sgbm_.disparity.uniqueness_percent);
  options.Add({.name = "left-right-tolerance",
               .help = "by how much the matches from left and from right may differ",
               .unit = "px",
               .min = 0},
              &sgbm_.disparity.left_right_tolerance_px);
  options.Add({.name = "rectification",
               .help = "how the images are rectified; auto: pinhole up to 90 degrees of view",
               .choices = {"auto", "pinhole", "lat-lon"}},
              &rectification_);
  options.Add({.name = "resolution",
               .help = "rectified pixels a pixel of the image",
               .unit = "px",
               .min = 0.05,
               .max = 8},
              &sgbm_.rectification.pixels_per_input_pixel);
}

MeasureOptions MeasureCommand::SgbmOptions(std::uint64_t seed) const {
  MeasureOptions options = sgbm_;
  options.step_px = step_px_.value_or(1);
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  options.rectification.kind = rectification_ == "pinhole"   ? RectificationKind::kPinhole
                               : rectification_ == "lat-lon" ? RectificationKind::kLatLon
                                                             : RectificationKind::kAuto;
  options.turn_into_ground_frame = evaluation_.in_ground_frame();
  options.point_covariance = evaluation_.point_covariance();
  options.ground = evaluation_.ground();
  options.ground.seed = seed;
  options.Check();
  return options;
}

Measurement MeasureCommand::Sgbm(const RigInput& rig, std::uint64_t seed) const {
  MeasureOptions options = SgbmOptions(seed);
  options.likely_distance_mm = rig.working_distance_mm;
  const auto stereo = std::make_shared<const StereoMeasurement>(rig.rig, options);
  Measurement out{{.rig = rig.rig,
                   .grid_px = stereo->grid_px(),
                   .recipe_toml = {},
                   .inputs = {},
                   .rig_extras = {}},
                  {},
                  {},
                  1,
                  {},
                  {}};
  out.header.step_px = options.step_px;
  out.header.subset_px = stereo->window_px();
  out.header.contents.covariance = options.point_covariance;
  out.measure = [stereo](const StereoFrame& pair, std::int64_t) -> ReportedFrame {
    MeasuredFrame measured = stereo->Measure(pair);
    return {std::move(measured.frame), measured.summary, std::nullopt, 0};
  };
  out.first_to_measure = [](std::int64_t wanted) { return wanted; };
  return out;
}

// The pair that displacements count from, and its files where those of the frames may lack them.
StereoFrame MeasureCommand::ReferencePair(std::vector<fs::path>* files) const {
  ImageSourceOptions options = recording_.frames().Options();
  if (reference_frame_) options.frames = fmt::format("{}", *reference_frame_);
  const auto source = recording_.Open(options);
  std::string problem;
  while (std::optional<StereoFrame> pair = source->Next()) {
    if (pair->problem.empty()) {
      if (reference_frame_) *files = source->Files();
      return std::move(*pair);
    }
    if (problem.empty()) problem = pair->problem;
  }
  if (problem.empty()) throw InputError("There are no frames to measure.");
  throw InputError(
      fmt::format("No pair can serve as the reference that displacements count from: {}", problem));
}

StereoRunOptions MeasureCommand::DicOptions(std::uint64_t seed, int bits) const {
  StereoRunOptions options =
      dic_.Options(seed, bits, step_px_.value_or(8), evaluation_.Options(seed, rolling_.given()));
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  return options;
}

Measurement MeasureCommand::Dic(const RigInput& rig, std::uint64_t seed) const {
  evaluation_.Options(seed);  // before anything is read: what is wrong with them
  std::vector<fs::path> files;
  const StereoFrame reference = ReferencePair(&files);
  const StereoRunOptions options = DicOptions(seed, reference.left.bits);
  const auto run = std::make_shared<StereoRun>(rig.rig, reference, options);
  Measurement out{run->Header(), {}, {}, options.block_frames, run->Notes(), files};
  out.measure = [run](const StereoFrame& pair, std::int64_t position) {
    return Reported(run->Measure(pair, position));
  };
  out.first_to_measure = [run](std::int64_t wanted) { return run->FirstToMeasure(wanted); };
  return out;
}

void MeasureCommand::CheckRolling() const {
  (void)delay_.Delay();
  if (!rolling_.given()) {
    if (delay_.given()) {
      throw UsageError(
          "--right-delay is for a rolling tyre, whose motion --reference tells; leave it out.");
    }
    if (recording_.has_rig()) return;
    throw UsageError(
        "--rig is missing: give the calibrated rig, or the wheel of a rolling tyre with "
        "--reference.");
  }
  if (recording_.has_rig()) {
    throw UsageError("The rig comes from the wheel file of --reference; leave out --rig.");
  }
  if (matcher_ == "sgbm") {
    throw UsageError("A rolling tyre is measured with --matcher dic, not sgbm.");
  }
  if (reference_frame_) {
    throw UsageError(
        "Displacements of a rolling tyre count from the wheel of --reference; leave out "
        "--reference-frame.");
  }
}

// With the modes of what may be wrong beside the calibration; the carcass's are the last ones.
WheelReference MeasureCommand::Wheel() const {
  WheelReference wheel = rolling_.Wheel();
  RightDelay delay = delay_.Delay().value_or(wheel.right_delay.value_or(RightDelay{}));
  // How sure an estimate is shows later.
  if (delay_.estimate() && wheel.rig.modes.count() > 0) delay.sigma_s = RightDelay::kMost_s;
  return contact_.WithCarcass(WithDelayMode(std::move(wheel), delay));
}

// The first pass over a rolling tyre. Nothing: stopped.
std::optional<Measurement> MeasureCommand::Rolling(const CommonOptions& common,
                                                   std::vector<Channel>* channels) const {
  contact_.CheckChannels(*channels);
  std::vector<fs::path> files;
  const int bits = ReferencePair(&files).left.bits;
  RollingRunOptions options = rolling_.Options(DicOptions(common.seed, bits), dic_.order_given());
  options.right_delay = delay_.Delay();
  options.estimate_right_delay = delay_.estimate();
  const auto run = std::make_shared<RollingRun>(Wheel(), options);
  RollingContactOptions contact = contact_.Options(run->reference().profile.crown_y_mm);
  const auto source = recording_.Open();
  std::optional<Progress> progress(std::in_place, "finding the wheel", source->DeclaredCount(),
                                   common.progress());
  const bool whole = run->Survey(*source, [&](std::int64_t done, std::int64_t) {
    if (done > 0) progress->Advance();
    return !InterruptGuard::Requested();
  });
  progress.reset();
  if (!whole) return std::nullopt;
  const std::string clock = FindContact(contact_, std::move(contact), *run, channels);
  Measurement out{run->Header(), {}, {}, 1, run->Notes(), files};
  if (!clock.empty()) out.notes.push_back(clock);
  out.more["right_delay_ms"] = JsonOf(run->right_delay_used(), run->right_delay());
  out.measure = [run](const StereoFrame& pair, std::int64_t position) {
    return Reported(run->Measure(pair, position));
  };
  out.first_to_measure = [](std::int64_t wanted) { return wanted; };
  return out;
}

RigInput MeasureCommand::Rig() const {
  if (!rolling_.given()) return recording_.Rig();
  return {rolling_.Wheel().rig, std::nullopt, {rolling_.file()}, {}};
}

CommandReport MeasureCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const bool dic = matcher_ == "dic" || rolling_.given();
  CheckRolling();
  const fs::path output = CheckedOutput(output_, overwrite_ || resume_);
  if (resume_) {
    if (const auto report = FinishedRun(output, output_, recipe_toml)) return *report;
  }
  std::optional<SeriesShard> shard;
  if (!shard_.empty()) shard = ParseShard(shard_);
  if (!dic) SgbmOptions(common.seed);  // before anything is read: what is wrong with them
  const RigInput rig = Rig();
  if (rig.rig.modes.count() == 0) {
    spdlog::info(
        "Note: this calibration does not say how sure it is, so the calibration part of all "
        "uncertainties is unknown (NaN). Calibrate with plumbline calibrate to have it.");
  }
  std::vector<Channel> channels = channels_.Read();
  const auto source = recording_.Open();
  const InterruptGuard guard;
  std::optional<Measurement> chosen;
  if (rolling_.given()) {
    chosen = Rolling(common, &channels);
  } else {
    chosen = dic ? Dic(rig, common.seed) : Sgbm(rig, common.seed);
  }
  if (!chosen) {
    spdlog::error("Stopped before the first frame was finished; nothing was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  Measurement& measurement = *chosen;
  for (const std::string& note : measurement.notes) spdlog::info("Note: {}", note);

  SeriesHeader& header = measurement.header;
  header.recipe_toml = recipe_toml;
  header.channels = channels;
  header.inputs = source->Files();
  for (const fs::path& file : measurement.inputs) {
    const auto end = header.inputs.end();
    if (std::find(header.inputs.begin(), end, file) == end) header.inputs.push_back(file);
  }
  for (const std::string& file : rig.files) header.inputs.emplace_back(file);
  for (const std::string& file : {mask_, recording_.frames().timestamps(), channels_.file(),
                                  dic ? dic_.noise() : std::string()}) {
    if (!file.empty()) header.inputs.emplace_back(file);
  }
  MeasuredRange range;
  if (shard) {
    header.shard = CutOut(*shard, source->DeclaredCount(), measurement.block_frames);
    range.first_wanted = header.shard->first_frame;
    range.end = EndOf(*header.shard);
  }

  SeriesWriter writer(output, header, resume_ ? SeriesStart::kResume : SeriesStart::kNew);
  const std::int64_t kept = writer.committed();
  range.first_wanted += kept;
  range.first = std::min(range.first_wanted, measurement.first_to_measure(range.first_wanted));
  if (kept > 0) spdlog::info("Going on after the {} frames that are there.", kept);
  const std::int64_t declared =
      (range.end ? *range.end : source->DeclaredCount()) - range.first_wanted;
  MeasureReport report(output, declared, rig.rig.modes.count() > 0);
  const auto begin = std::chrono::steady_clock::now();
  {
    Progress progress(kept > 0 ? "measuring the rest" : "measuring", declared, common.progress());
    SizeGuard sizes;
    const bool stopped = RunFlow(
        *source, range,
        [&](const StereoFrame& pair, std::int64_t position) {
          return sizes(pair,
                       [&](const StereoFrame& one) { return measurement.measure(one, position); });
        },
        [&](const ReportedFrame& measured) {
          CommitFrame(measured.frame, output, writer);
          if (!measured.frame.problem.empty()) {
            progress.Note(fmt::format("Frame {} is marked as bad: {}", measured.frame.index,
                                      measured.frame.problem));
          }
          if (measured.frame.rig_watch.alarm) {
            progress.Note(AlarmText(measured.frame.index, measured.frame.rig_watch));
          }
          report.Add(measured);
          progress.SetDetail(report.ShareText());
          progress.Advance();
        },
        [] { return InterruptGuard::Requested(); });
    if (stopped) report.SetInterrupted(KeptText(writer.committed(), output), false);
  }
  report.SetSeconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  const std::vector<std::string> notes = source->Notes();
  for (const std::string& note : notes) spdlog::info("Note: {}", note);
  if (report.frames() + kept == 0) {
    spdlog::error(report.interrupted() ? "Stopped before the first frame was finished; nothing was "
                                         "written."
                                       : "There are no frames to measure; nothing was written.");
    return {"", {{"interrupted", report.interrupted()}}, report.interrupted() ? 130 : 3};
  }
  // An interrupted run stays as it is, to be gone on with.
  if (!report.interrupted()) writer.Close();
  CommandReport result = report.Make();
  std::vector<std::string> all = measurement.notes;
  all.insert(all.end(), notes.begin(), notes.end());
  result.json["notes"] = all;
  result.json.update(measurement.more);
  return result;
}

}  // namespace

std::unique_ptr<Command> MakeMeasureCommand() { return std::make_unique<MeasureCommand>(); }

}  // namespace plumbline::internal
