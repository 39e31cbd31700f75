#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>

#include "apps/internal/command.h"
#include "apps/internal/field_options.h"
#include "apps/internal/frame_options.h"
#include "apps/internal/planar_report.h"
#include "apps/internal/result_file.h"
#include "apps/internal/strain_options.h"
#include "apps/interrupt.h"
#include "calib/error.h"
#include "io/noise_file.h"
#include "io/planar_series_writer.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

class CorrelateCommand : public Command {
 public:
  std::string Name() const override { return "correlate"; }
  std::string Summary() const override {
    return "Displacement and strain from the images of one camera (2D-DIC), with error bars.";
  }
  std::string Footer() const override {
    return "Example:\n"
           "  plumbline correlate --reference test/img_0000.png --deformed 'test/img_*.png' -o "
           "field.h5\n"
           "Other strain windows need no second correlation: plumbline analyse field.h5 -o "
           "strain.h5 --strain-window 15";
  }
  void Declare(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  void DeclareImages(OptionTable& options);
  void DeclareMatching(OptionTable& options);
  void DeclareSequence(OptionTable& options);
  PlanarRunOptions Options(std::uint64_t seed, int bits) const;
  void SetReferenceMode(SequenceOptions& sequence) const;
  void CorrelateAll(PlanarRun& run, ImageSequence& images, PlanarSeriesWriter& writer,
                    ProgressStyle style, PlanarReport& report) const;

  std::string reference_, output_ = "field.h5";
  std::vector<std::string> deformed_;
  FrameOptionSet frames_;
  std::string roi_, mask_;
  bool overwrite_ = false;
  FieldOptionSet matching_;
  int step_px_ = 8;
  SequenceOptions sequence_;
  std::string reference_mode_ = "fixed";
  bool no_strain_ = false, gradient_covariance_ = false;
  StrainOptionSet strain_;
};

void CorrelateCommand::Declare(OptionTable& options) {
  DeclareImages(options);
  DeclareMatching(options);
  DeclareSequence(options);
  options.Add({.name = "no-strain", .help = "leave the strain out"}, &no_strain_);
  strain_.Declare(options, StrainOptionSet::Of::kPlanar);
  options.Add({.name = "gradient-covariance",
               .help = "also store the 4x4 covariance of each subset's gradient"},
              &gradient_covariance_);
}

void CorrelateCommand::DeclareImages(OptionTable& options) {
  options.Add({.name = "reference",
               .help = "image of the state that displacements count from; of a video or a folder "
                       "its first",
               .unit = "FILE",
               .required = true},
              &reference_);
  options.Add({.name = "deformed",
               .help = "images to correlate with it, in order: files, a pattern in quotes, a "
                       "folder or a video",
               .unit = "FILES",
               .required = true},
              &deformed_);
  options.Add(
      {.name = "output", .help = "where the result goes", .unit = "FILE", .short_name = "o"},
      &output_);
  options.Add({.name = "overwrite", .help = "replace the output file if it is there"}, &overwrite_);
  frames_.Declare(options, "deformed images", "deformed image");
  options.Add({.name = "roi",
               .help = "region of the reference to measure; empty: all of it",
               .unit = "X,Y,W,H px"},
              &roi_);
  options.Add({.name = "mask",
               .help = "image of the reference's size: 0 is left out, all else (1 or 255) measured",
               .unit = "FILE"},
              &mask_);
}

void CorrelateCommand::DeclareMatching(OptionTable& options) {
  options.Add({.name = "step",
               .help = "distance between points in the reference",
               .unit = "px",
               .min = 1,
               .max = 10000},
              &step_px_);
  matching_.Declare(options);
}

void CorrelateCommand::DeclareSequence(OptionTable& options) {
  options.Add({.name = "reference-mode",
               .help = "what each image is correlated with: fixed, the reference; every, an image "
                       "of the sequence, taken anew every so many (--update-every); auto, taken "
                       "anew when fewer points are found or correlate less. Displacements always "
                       "count from the reference",
               .choices = {"fixed", "every", "auto"}},
              &reference_mode_);
  options.Add(
      {.name = "update-every",
       .help = "images after which the reference is taken anew, with --reference-mode every",
       .min = 1,
       .max = 1e9},
      &sequence_.update_every);
}

void CorrelateCommand::SetReferenceMode(SequenceOptions& sequence) const {
  sequence.reference = reference_mode_ == "every"  ? ReferenceMode::kEvery
                       : reference_mode_ == "auto" ? ReferenceMode::kAuto
                                                   : ReferenceMode::kFixed;
}

PlanarRunOptions CorrelateCommand::Options(std::uint64_t seed, int bits) const {
  PlanarRunOptions options;
  options.sequence = sequence_;
  SetReferenceMode(options.sequence);
  FieldOptions& field = options.sequence.field;
  field = matching_.Options(seed);
  field.step_px = step_px_;
  if (!matching_.noise().empty()) {
    field.correlator.noise = ReadCameraNoise(matching_.noise(), "camera").ForBits(bits);
    options.noise_source = fs::path(matching_.noise()).filename().string();
  }
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  options.strain = !no_strain_;
  options.strain_options = strain_.Options();
  options.gradient_covariance = gradient_covariance_;
  options.Check();
  return options;
}

void CorrelateCommand::CorrelateAll(PlanarRun& run, ImageSequence& images,
                                    PlanarSeriesWriter& writer, ProgressStyle style,
                                    PlanarReport& report) const {
  Progress progress("correlating", images.DeclaredCount(), style);
  while (!InterruptGuard::Requested()) {
    const std::optional<SequenceImage> image = images.Next();
    if (!image) return;
    const CorrelatedFrame frame = run.Correlate(*image);
    writer.Commit(frame.frame);
    if (!frame.frame.problem.empty()) {
      progress.Note(
          fmt::format("Frame {} is marked as bad: {}", frame.frame.index, frame.frame.problem));
    }
    report.Add(frame);
    progress.Advance();
  }
  report.SetInterrupted();
}

// The first image of what --reference names.
SequenceImage ReadReference(const std::string& reference, std::vector<fs::path>* files) {
  ImageSourceOptions first;
  first.frames = "0:1";
  const auto images = OpenImageSequence(reference, first);
  std::optional<SequenceImage> image = images->Next();
  if (!image) throw InputError(fmt::format("'{}' holds no image.", reference));
  if (!image->problem.empty()) throw InputError(image->problem);
  *files = images->Files();
  return std::move(*image);
}

CommandReport CorrelateCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const fs::path output = CheckedOutput(output_, overwrite_);
  std::vector<fs::path> inputs;
  const SequenceImage reference = ReadReference(reference_, &inputs);
  ImageSourceOptions source = frames_.Options();
  source.expected_size = reference.image.size();
  const auto images = OpenImageSequence(deformed_, source);
  const PlanarRunOptions options = Options(common.seed, reference.image.bits);
  PlanarRun run(reference.image, options);

  PlanarSeriesHeader header = run.Header();
  header.reference_id = reference.id;
  header.recipe_toml = recipe_toml;
  header.inputs = inputs;
  for (const fs::path& file : images->Files()) header.inputs.push_back(file);
  for (const std::string& file : {mask_, matching_.noise(), frames_.timestamps()}) {
    if (!file.empty()) header.inputs.emplace_back(file);
  }

  const InterruptGuard guard;
  PlanarReport report(output, images->DeclaredCount(), header, options.sequence.reference);
  PlanarSeriesWriter writer(output, header);
  CorrelateAll(run, *images, writer, common.progress(), report);
  if (report.frames() == 0) {
    spdlog::error(report.interrupted() ? "Stopped before the first frame was finished; nothing was "
                                         "written."
                                       : "There are no images to correlate; nothing was written.");
    return {"", {{"interrupted", report.interrupted()}}, report.interrupted() ? 130 : 3};
  }
  writer.Close();
  if (const std::string complaint = report.Complaint(); !complaint.empty()) {
    spdlog::error(complaint);
  }
  return report.Make(images->Notes());
}

}  // namespace

std::unique_ptr<Command> MakeCorrelateCommand() { return std::make_unique<CorrelateCommand>(); }

}  // namespace plumbline::internal
