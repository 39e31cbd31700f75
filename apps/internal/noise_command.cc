#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "apps/internal/command.h"
#include "apps/internal/foreign_rig_options.h"
#include "apps/internal/measure_report.h"
#include "apps/internal/noise_report.h"
#include "apps/internal/result_file.h"
#include "apps/internal/stereo_options.h"
#include "apps/interrupt.h"
#include "apps/noise_floor.h"
#include "apps/region.h"
#include "apps/rig_input.h"
#include "apps/stereo_run.h"
#include "calib/error.h"
#include "io/image_sequence.h"
#include "io/image_source.h"
#include "io/noise_file.h"
#include "io/series_writer.h"
#include "match/photon_transfer.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

class NoiseCommand : public Command {
 public:
  std::string Name() const override { return "noise"; }
  std::string Summary() const override {
    return "Find the noise of cameras from still frames, and of a rig the noise floor of "
           "displacement "
           "and strain.";
  }
  std::string Footer() const override {
    return "Take 2 frames or more (10 are good) of a scene at rest that has dark and bright parts, "
           "such\nas the unloaded specimen, one right after the other, and do not touch anything.\n"
           "With --left and --right both cameras are looked at; with --rig the pairs are measured "
           "as by\nmeasure --matcher dic, with that noise, and what scatters is held against the "
           "sigmas.\n"
           "Other commands read the file with --noise.\n"
           "Examples:\n"
           "  plumbline noise --images still/ -o noise.toml\n"
           "  plumbline noise --images 'still/cam0_*.png' --camera left -o rig_noise.toml\n"
           "  plumbline noise --rig rig.h5 --left 'still/left*' --right 'still/right*' -o "
           "noise.toml";
  }

  void Declare(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  void DeclareRig(OptionTable& options);
  void CheckChoice() const;
  ImageSourceOptions SourceOptions() const;
  std::optional<PixelRegion> Region() const;
  Image<std::uint8_t> Mask() const;
  std::unique_ptr<PhotonTransferFit> Collect(ImageSequence& images, ProgressStyle style,
                                             std::vector<std::string>* problems) const;
  CommandReport RunOfCamera(const CommonOptions& common) const;
  void Write(const PhotonTransfer& found) const;

  // Of both cameras; nothing: stopped.
  struct Pair {
    PhotonTransfer left, right;
  };
  std::optional<Pair> BothCameras(ProgressStyle style, std::vector<std::string>* notes,
                                  std::vector<std::string>* problems) const;
  // Nothing: stopped.
  std::optional<NoiseFloor> Floor(const RigInput& rig, const NoiseFile& noise,
                                  const CommonOptions& common, const std::string& recipe_toml,
                                  std::vector<std::string>* notes) const;
  StereoRunOptions RunOptions(std::uint64_t seed, const NoiseFile& noise, int bits) const;
  CommandReport RunOfRig(const CommonOptions& common, const std::string& recipe_toml) const;

  std::string images_, left_, right_, rig_, output_ = "noise.toml", camera_ = "camera", frames_;
  std::string roi_, mask_, floor_;
  ForeignRigOptionSet foreign_rig_;
  bool overwrite_ = false;
  std::optional<int> step_px_;
  PhotonTransferOptions options_;
  StereoOptionSet dic_;
  EvaluationOptionSet evaluation_;
};

void NoiseCommand::Declare(OptionTable& options) {
  options.Add({.name = "images",
               .help = "still frames of one camera: a pattern in quotes, a folder or a video",
               .unit = "PATTERN"},
              &images_);
  options.Add({.name = "left",
               .help = "still frames of the left camera of a rig, in place of --images",
               .unit = "PATTERN"},
              &left_);
  options.Add({.name = "right", .help = "those of the right camera", .unit = "PATTERN"}, &right_);
  options.Add({.name = "output",
               .help = "noise file to write; the other camera's part of it is kept",
               .unit = "FILE",
               .short_name = "o"},
              &output_);
  options.Add({.name = "camera",
               .help = "which camera --images are of, for the file",
               .choices = {"camera", "left", "right"}},
              &camera_);
  options.Add({.name = "frames", .help = "which frames, as first:end:step", .unit = "a:b:c"},
              &frames_);
  options.Add(
      {.name = "roi",
       .help = "only this part of the images; with --rig, of the left one: where the points "
               "of the noise floor lie",
       .unit = "x,y,w,h"},
      &roi_);
  options.Add(
      {.name = "mask", .help = "image that is 0 where not to look, as --roi", .unit = "FILE"},
      &mask_);
  options.Add({.name = "max-motion",
               .help = "two frames that moved more than that are not used",
               .unit = "px",
               .min = 0.01,
               .max = 0.5},
              &options_.max_motion_px);
  DeclareRig(options);
}

void NoiseCommand::DeclareRig(OptionTable& options) {
  options.Add({.name = "rig",
               .help = "the calibrated rig, as for measure: also find the noise floor of "
                       "displacement and strain",
               .unit = "FILE"},
              &rig_);
  options.Add({.name = "floor",
               .help = "also write the static pairs as a run (.h5), with a map of each",
               .unit = "FILE"},
              &floor_);
  options.Add({.name = "overwrite", .help = "replace that file if it is there"}, &overwrite_);
  options.Add({.name = "step",
               .help = "distance between points in the left image; auto: 8",
               .unit = "px",
               .min = 1,
               .max = 10000},
              &step_px_);
  dic_.Declare(options, false);
  evaluation_.DeclareGround(options);
  evaluation_.Declare(options);
  foreign_rig_.Declare(options);
}

CameraNoise NoiseOf(const PhotonTransfer& found) {
  return {.model = found.model,
          .cov = found.cov,
          .bits = found.bits,
          .frames = found.frames,
          .size = found.size,
          .lowest_grey = found.lowest_grey,
          .highest_grey = found.highest_grey,
          .created = ""};
}

// Notes, problems and where it was written, as every way of this command ends.
void Finish(CommandReport& report, const std::vector<std::string>& notes,
            const std::vector<std::string>& problems, const std::string& output) {
  report.json["output"] = fs::absolute(output).string();
  report.json["notes"] = notes;
  report.json["problems"] = problems;
  for (const std::string& note : notes) report.text += "Please note: " + note + ".\n";
  report.text +=
      fmt::format("Wrote {}: give it to other commands as --noise {}.\n", output, output);
}

CommandReport Stopped() {
  spdlog::error("Stopped; no noise file was written.");
  return {"", {{"interrupted", true}}, 130};
}

ImageSourceOptions NoiseCommand::SourceOptions() const {
  ImageSourceOptions source;
  source.frames = frames_;
  return source;
}

std::optional<PixelRegion> NoiseCommand::Region() const {
  return roi_.empty() ? std::nullopt : std::optional(PixelRegion::Parse(roi_));
}

Image<std::uint8_t> NoiseCommand::Mask() const {
  return mask_.empty() ? Image<std::uint8_t>() : ReadMask(mask_);
}

std::unique_ptr<PhotonTransferFit> NoiseCommand::Collect(ImageSequence& images, ProgressStyle style,
                                                         std::vector<std::string>* problems) const {
  const Image<std::uint8_t> mask = Mask();
  const std::optional<PixelRegion> roi = Region();
  std::unique_ptr<PhotonTransferFit> fit;
  const InterruptGuard guard;
  Progress progress("comparing frames", images.DeclaredCount(), style);
  while (const auto frame = images.Next()) {
    if (InterruptGuard::Requested()) return nullptr;
    progress.Advance();
    if (!frame->problem.empty()) {
      progress.Note("Left out: " + frame->problem);
      problems->push_back(frame->problem);
      continue;
    }
    if (!fit) {
      fit = std::make_unique<PhotonTransferFit>(options_,
                                                WantedPixels(frame->image.size(), roi, mask));
    }
    fit->Add(frame->image);
  }
  if (!fit) fit = std::make_unique<PhotonTransferFit>(options_);  // which says that there are none
  return fit;
}

void NoiseCommand::Write(const PhotonTransfer& found) const {
  NoiseFile file;
  if (camera_ != "camera" && fs::exists(output_)) {
    file = ReadNoiseFile(output_);
    file.cameras.erase("camera");
  }
  file.cameras[camera_] = NoiseOf(found);
  WriteNoiseFile(output_, file);
}

CommandReport NoiseCommand::RunOfCamera(const CommonOptions& common) const {
  const auto images = OpenImageSequence(images_, SourceOptions());
  std::vector<std::string> problems;
  const std::unique_ptr<PhotonTransferFit> fit = Collect(*images, common.progress(), &problems);
  if (!fit) return Stopped();
  const PhotonTransfer found = fit->Fit();
  Write(found);
  std::vector<std::string> notes = images->Notes();
  notes.insert(notes.end(), found.notes.begin(), found.notes.end());
  CommandReport report{TextOf(found), JsonOf(found)};
  Finish(report, notes, problems, output_);
  return report;
}

std::optional<NoiseCommand::Pair> NoiseCommand::BothCameras(
    ProgressStyle style, std::vector<std::string>* notes,
    std::vector<std::string>* problems) const {
  const auto source = OpenImageSource(left_, right_, SourceOptions());
  PhotonTransferFit left(options_), right(options_);
  Progress progress("comparing frames", source->DeclaredCount(), style);
  while (const auto pair = source->Next()) {
    if (InterruptGuard::Requested()) return std::nullopt;
    progress.Advance();
    if (!pair->problem.empty()) {
      progress.Note("Left out: " + pair->problem);
      problems->push_back(pair->problem);
      continue;
    }
    left.Add(pair->left);
    right.Add(pair->right);
  }
  *notes = source->Notes();
  return Pair{left.Fit(), right.Fit()};
}

StereoRunOptions NoiseCommand::RunOptions(std::uint64_t seed, const NoiseFile& noise,
                                          int bits) const {
  StereoRunOptions options =
      dic_.Options(seed, bits, step_px_.value_or(8), evaluation_.Options(seed));
  options.sequence.field.correlator.noise = noise.cameras.at("left").ForBits(bits);
  options.sequence.right_noise = noise.cameras.at("right").ForBits(bits);
  options.roi = Region();
  options.mask = Mask();
  options.evaluation.matches = true;          // for the scatter in the images
  options.evaluation.count_left_out = false;  // what is asked is whether noise alone is as claimed
  return options;
}

std::optional<NoiseFloor> NoiseCommand::Floor(const RigInput& rig, const NoiseFile& noise,
                                              const CommonOptions& common,
                                              const std::string& recipe_toml,
                                              std::vector<std::string>* notes) const {
  const auto source = OpenImageSource(left_, right_, SourceOptions());
  std::unique_ptr<StereoRun> run;
  std::unique_ptr<NoiseFloorMeasurement> floor;
  std::unique_ptr<SeriesWriter> writer;
  Progress progress("measuring", source->DeclaredCount(), common.progress());
  bool stopped = false;
  for (std::int64_t position = 0; const auto pair = source->Next(); ++position) {
    stopped = InterruptGuard::Requested();
    if (stopped) break;
    if (!run) {
      if (!pair->problem.empty()) continue;  // has been said
      run = std::make_unique<StereoRun>(rig.rig, *pair,
                                        RunOptions(common.seed, noise, pair->left.bits));
      SeriesHeader header = run->Header();
      floor = std::make_unique<NoiseFloorMeasurement>(header, run->correlation_area_points());
      header.recipe_toml = recipe_toml;
      header.contents.matches = dic_.stores_matches();
      header.inputs = source->Files();
      for (const std::string& file : rig.files) header.inputs.emplace_back(file);
      if (!mask_.empty()) header.inputs.emplace_back(mask_);
      if (!floor_.empty()) {
        writer = std::make_unique<SeriesWriter>(CheckedOutput(floor_, overwrite_), header);
      }
      for (const std::string& note : run->Notes()) spdlog::info("Note: {}", note);
    }
    const StereoRunFrame measured = run->Measure(*pair, position);
    if (measured.frame.rig_watch.alarm) {
      notes->push_back(AlarmText(measured.frame.index, measured.frame.rig_watch));
      notes->back().pop_back();  // its full stop
    }
    floor->Add(measured.frame);
    if (writer) writer->Commit(measured.frame);
    progress.Advance();
  }
  if (writer) writer->Close();
  if (stopped) return std::nullopt;
  return floor->Result();
}

CommandReport NoiseCommand::RunOfRig(const CommonOptions& common,
                                     const std::string& recipe_toml) const {
  std::optional<RigInput> rig;
  if (!rig_.empty()) {
    rig = OpenRig(rig_, foreign_rig_.Options());
    for (const std::string& note : rig->notes) spdlog::info("Note: {}", note);
    if (!floor_.empty()) CheckedOutput(floor_, overwrite_);
    evaluation_.Options(common.seed);  // before anything is read: what is wrong with them
  }
  const InterruptGuard guard;
  std::vector<std::string> notes, problems;
  const std::optional<Pair> found = BothCameras(common.progress(), &notes, &problems);
  if (!found) return Stopped();
  NoiseFile file;
  CommandReport report;
  for (const auto& [name, title, camera] : {std::tuple("left", "Left camera: ", &found->left),
                                            std::tuple("right", "Right camera: ", &found->right)}) {
    file.cameras[name] = NoiseOf(*camera);
    report.json[name] = JsonOf(*camera);
    report.text += title + TextOf(*camera);
    for (const std::string& note : camera->notes) {
      notes.push_back(fmt::format("{} camera: {}", name, note));
    }
  }
  if (rig) {
    file.floor = Floor(*rig, file, common, recipe_toml, &notes);
    if (!file.floor) return Stopped();
    report.json["floor"] = JsonOf(*file.floor);
    report.text += TextOf(*file.floor);
    const std::vector<std::string> more = NotesOf(*file.floor);
    notes.insert(notes.end(), more.begin(), more.end());
    if (!floor_.empty()) report.json["floor_file"] = fs::absolute(floor_).string();
  }
  WriteNoiseFile(output_, file);
  Finish(report, notes, problems, output_);
  return report;
}

// Which of the two ways it is.
void NoiseCommand::CheckChoice() const {
  const bool pairs = !left_.empty() && !right_.empty();
  if (images_.empty() ? !pairs : !left_.empty() || !right_.empty()) {
    throw UsageError(
        "Give either --images, still frames of one camera, or --left and --right, those of a rig.");
  }
  if (!rig_.empty() && !pairs) throw UsageError("--rig needs --left and --right.");
  if (!floor_.empty() && rig_.empty()) throw UsageError("--floor needs --rig, --left and --right.");
  if (pairs && rig_.empty() && !(roi_.empty() && mask_.empty())) {
    throw UsageError("--roi and --mask are of one image: with --left and --right they need --rig.");
  }
  if (pairs && camera_ != "camera") throw UsageError("--camera says what --images are.");
  if (evaluation_.remove_rigid_motion()) {
    throw UsageError("The noise floor is told with and without rigid motion in any case.");
  }
  if (dic_.strategy() == StereoStrategy::kIncremental) {
    throw UsageError(
        "The noise floor is that of pairs measured against one reference: --strategy incremental "
        "adds errors up.");
  }
}

CommandReport NoiseCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  options_.Check();
  CheckChoice();
  return images_.empty() ? RunOfRig(common, recipe_toml) : RunOfCamera(common);
}

}  // namespace

std::unique_ptr<Command> MakeNoiseCommand() { return std::make_unique<NoiseCommand>(); }

}  // namespace plumbline::internal
