#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <memory>
#include <optional>

#include "apps/internal/command.h"
#include "apps/internal/field_options.h"
#include "apps/internal/foreign_rig_options.h"
#include "apps/internal/result_file.h"
#include "apps/internal/wheel_report.h"
#include "apps/interrupt.h"
#include "apps/rig_input.h"
#include "apps/wheel_reference_run.h"
#include "calib/error.h"
#include "io/noise_file.h"
#include "io/wheel_file.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

class ReferenceCommand : public Command {
 public:
  std::string Name() const override { return "reference"; }
  std::string Summary() const override {
    return "Find a wheel's axis, its angle in every frame and its undeformed shape from a "
           "recording of "
           "it lifted and turning slowly.";
  }
  std::string Footer() const override {
    return "Lift the wheel, let the cameras stand still inside the tyre, and turn it slowly by a "
           "little more\nthan once, in the direction in which it rolls: 100 frames or more a turn, "
           "exposed short enough\nnot to blur. After a full turn the first frames are seen again, "
           "which holds the angles.\n"
           "Example:\n"
           "  plumbline reference --rig rig.h5 --left 'lifted/left/*.png' --right "
           "'lifted/right/*.png' -o wheel.h5";
  }
  void Declare(OptionTable& options) override;
  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  WheelReferenceRunOptions Options(std::uint64_t seed, int bits) const;
  std::unique_ptr<ImageSource> Open() const;
  int Bits() const;

  static constexpr int kSubset_px = 21;

  std::string rig_, left_, right_, output_ = "wheel.h5", frames_, roi_, mask_, timestamps_;
  std::optional<double> frames_per_second_;
  std::optional<int> step_px_;
  bool overwrite_ = false;
  double spacing_share_ = WheelChainOptions().least_seen_share;
  FieldOptionSet matching_{kSubset_px};
  ForeignRigOptionSet foreign_rig_;
};

void ReferenceCommand::Declare(OptionTable& options) {
  options.Add({.name = "rig",
               .help = "the calibrated rig, as for measure",
               .unit = "FILE",
               .required = true},
              &rig_);
  options.Add({.name = "left",
               .help = "images of the left camera: a pattern in quotes, a folder or a video",
               .unit = "FILES",
               .required = true},
              &left_);
  options.Add(
      {.name = "right", .help = "those of the right camera", .unit = "FILES", .required = true},
      &right_);
  options.Add({.name = "output", .help = "wheel file to write", .unit = "FILE", .short_name = "o"},
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
               .help = "region of the left image where the wheel is seen; empty: all of it",
               .unit = "X,Y,W,H px"},
              &roi_);
  options.Add({.name = "mask",
               .help = "image of the left camera's size: 0 where something else is seen that does "
                       "not turn with the wheel",
               .unit = "FILE"},
              &mask_);
  options.Add({.name = "step",
               .help = "distance between points in the left image, at least the subset; auto: 3 "
                       "more",
               .unit = "px",
               .min = 5,
               .max = 1000},
              &step_px_);
  options.Add({.name = "next-view",
               .help = "a new reference image begins where less than this share of the last one's "
                       "points is still seen",
               .min = 0.25,
               .max = 0.95},
              &spacing_share_);
  matching_.Declare(options);
  foreign_rig_.Declare(options);
}

std::unique_ptr<ImageSource> ReferenceCommand::Open() const {
  ImageSourceOptions source;
  source.frames = frames_;
  source.frames_per_second = frames_per_second_;
  source.timestamps_csv = timestamps_;
  return OpenImageSource(left_, right_, source);
}

// Of the first image that can be read.
int ReferenceCommand::Bits() const {
  const auto source = Open();
  while (const auto pair = source->Next()) {
    if (pair->problem.empty()) return pair->left.bits;
  }
  return 8;
}

WheelReferenceRunOptions ReferenceCommand::Options(std::uint64_t seed, int bits) const {
  WheelReferenceRunOptions options;
  StereoSequenceOptions& matching = options.chain.matching;
  matching.field = matching_.Options(seed);
  matching.field.step_px = step_px_.value_or(matching.field.correlator.subset_px + 3);
  matching.seeds.seeds.features.random_seed = seed;
  options.chain.least_seen_share = spacing_share_;
  if (!matching_.noise().empty()) {
    matching.field.correlator.noise = ReadCameraNoise(matching_.noise(), "left").ForBits(bits);
    matching.right_noise = ReadCameraNoise(matching_.noise(), "right").ForBits(bits);
  }
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  options.Check();
  return options;
}

CommandReport ReferenceCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const fs::path output = CheckedOutput(output_, overwrite_);
  const RigInput rig = OpenRig(rig_, foreign_rig_.Options());
  for (const std::string& note : rig.notes) spdlog::info("Note: {}", note);
  const WheelReferenceRunOptions options =
      Options(common.seed, matching_.noise().empty() ? 8 : Bits());
  const InterruptGuard guard;
  std::unique_ptr<Progress> progress;
  std::string under_way;
  std::vector<std::string> notes;
  std::vector<fs::path> inputs;
  const auto open = [&] {
    auto source = Open();
    inputs = source->Files();
    return source;
  };
  WheelReferenceRun run = MeasureWheelReference(
      rig.rig, open, options, [&](const std::string& stage, std::int64_t done, std::int64_t total) {
        if (stage != under_way) {
          progress = std::make_unique<Progress>(stage, total, common.progress());
          under_way = stage;
        } else {
          progress->Advance();
        }
        return done < 0 || !InterruptGuard::Requested();
      });
  progress.reset();
  if (!run.wheel) {
    spdlog::error("Stopped; no wheel file was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  for (const std::string& file : rig.files) inputs.emplace_back(file);
  if (!mask_.empty()) inputs.emplace_back(mask_);
  WriteWheelFile(output, *run.wheel, recipe_toml, inputs);
  CommandReport report{TextOf(*run.wheel), JsonOf(*run.wheel)};
  report.json["output"] = fs::absolute(output).string();
  report.json["notes"] = run.notes;
  report.json["problems"] = run.problems;
  for (const std::string& problem : run.problems) report.text += "Left out: " + problem + "\n";
  for (const std::string& note : run.notes) report.text += "Please note: " + note + ".\n";
  report.text += fmt::format("Wrote {}.\n", output.string());
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeReferenceCommand() { return std::make_unique<ReferenceCommand>(); }

}  // namespace plumbline::internal
