#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <sstream>
#include <vector>

#include "apps/internal/command.h"
#include "apps/internal/delay_options.h"
#include "apps/internal/field_options.h"
#include "apps/internal/recording_options.h"
#include "apps/internal/result_file.h"
#include "apps/internal/wheel_report.h"
#include "apps/interrupt.h"
#include "apps/wheel_reference_run.h"
#include "calib/detect_tags.h"
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
  int Bits() const;

  static constexpr int kSubset_px = 21;

  RecordingOptionSet recording_;
  std::string output_ = "wheel.h5", roi_, mask_, tags_, rim_tags_;
  std::optional<int> step_px_;
  bool overwrite_ = false;
  double spacing_share_ = WheelChainOptions().least_seen_share;
  FieldOptionSet matching_{kSubset_px};
  DelayOptionSet delay_;
};

void ReferenceCommand::Declare(OptionTable& options) {
  recording_.Declare(options);
  options.Add({.name = "output", .help = "wheel file to write", .unit = "FILE", .short_name = "o"},
              &output_);
  options.Add({.name = "overwrite", .help = "replace the output file if it is there"}, &overwrite_);
  recording_.DeclareFrames(options);
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
  options.Add({.name = "tags",
               .help = "AprilTags on the wheel, by their family (36h11, 36h10, 25h9, 16h5): they "
                       "tell measure which part of the wheel a frame shows; empty: none",
               .unit = "FAMILY"},
              &tags_);
  options.Add({.name = "rim-tags",
               .help = "tags that are on the rim, by id, as 0,3,7-9: they tell the wheel's angle "
                       "whatever the tyre does; empty: all are on the tyre",
               .unit = "IDS"},
              &rim_tags_);
  delay_.Declare(options, "both expose together", false);
  matching_.Declare(options);
  recording_.DeclareForeign(options);
}

// "0,3,7-9" as the ids that it names.
std::vector<int> IdList(const std::string& text) {
  std::vector<int> ids;
  std::istringstream in(text);
  for (std::string item; std::getline(in, item, ',');) {
    int first = 0, last = 0, used = 0;
    const int read = std::sscanf(item.c_str(), "%d%n-%d%n", &first, &used, &last, &used);
    constexpr int kMost = 100'000;
    if (read < 2) last = first;
    if (read < 1 || used != static_cast<int>(item.size()) || first < 0 || last < first ||
        last > kMost) {
      throw UsageError(
          fmt::format("--rim-tags takes ids of tags between commas, as 0,3,7-9, not '{}'.", text));
    }
    for (int id = first; id <= last; ++id) ids.push_back(id);
  }
  return ids;
}

// Of the first image that can be read.
int ReferenceCommand::Bits() const {
  const auto source = recording_.Open();
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
  options.right_delay = delay_.Delay();
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  if (!tags_.empty()) options.tag_family = TagFamilyOf(tags_);
  options.rim_tags = IdList(rim_tags_);
  options.Check();
  return options;
}

CommandReport ReferenceCommand::Run(const CommonOptions& common, const std::string& recipe_toml) {
  const fs::path output = CheckedOutput(output_, overwrite_);
  const RigInput rig = recording_.Rig();
  const WheelReferenceRunOptions options =
      Options(common.seed, matching_.noise().empty() ? 8 : Bits());
  const InterruptGuard guard;
  std::unique_ptr<Progress> progress;
  std::string under_way;
  std::vector<fs::path> inputs;
  const auto open = [&] {
    auto source = recording_.Open();
    inputs = source->Files();
    return source;
  };
  WheelReferenceRun run = MeasureWheelReference(
      rig.rig, open, options, [&](const std::string& stage, std::int64_t, std::int64_t total) {
        if (stage != under_way) {
          progress = std::make_unique<Progress>(stage, total, common.progress());
          under_way = stage;
        } else {
          progress->Advance();
        }
        return !InterruptGuard::Requested();
      });
  progress.reset();
  if (!run.wheel) {
    spdlog::error("Stopped; no wheel file was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  for (const std::string& file : rig.files) inputs.emplace_back(file);
  for (const std::string& file : {mask_, recording_.frames().timestamps(), matching_.noise()}) {
    if (!file.empty()) inputs.emplace_back(file);
  }
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
