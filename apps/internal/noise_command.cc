#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/internal/command.h"
#include "apps/interrupt.h"
#include "apps/region.h"
#include "calib/error.h"
#include "io/image_sequence.h"
#include "io/noise_file.h"
#include "match/photon_transfer.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

std::string Percent(double share) { return fmt::format("{:.1f} %", 100 * share); }

class NoiseCommand : public Command {
 public:
  std::string Name() const override { return "noise"; }
  std::string Summary() const override {
    return "Find the noise of a camera from still frames: the photon-transfer line.";
  }
  std::string Footer() const override {
    return "Take 2 frames or more (10 are good) of a scene at rest that has dark and bright parts, "
           "such\nas the unloaded specimen, one right after the other, and do not touch anything.\n"
           "Other commands read the file with --noise.\n"
           "Examples:\n"
           "  plumbline noise --images still/ -o noise.toml\n"
           "  plumbline noise --images 'still/cam0_*.png' --camera left -o rig_noise.toml\n"
           "  plumbline noise --images 'still/cam1_*.png' --camera right -o rig_noise.toml";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "images",
                 .help = "still frames of one camera: a pattern in quotes, a folder or a video",
                 .unit = "PATTERN",
                 .required = true},
                &images_);
    options.Add({.name = "output",
                 .help = "noise file to write; the other camera's part of it is kept",
                 .unit = "FILE",
                 .short_name = "o"},
                &output_);
    options.Add({.name = "camera",
                 .help = "which camera it is, for the file",
                 .choices = {"camera", "left", "right"}},
                &camera_);
    options.Add({.name = "frames", .help = "which frames, as first:end:step", .unit = "a:b:c"},
                &frames_);
    options.Add({.name = "roi", .help = "only this part of the images", .unit = "x,y,w,h"}, &roi_);
    options.Add({.name = "mask", .help = "image that is 0 where not to look", .unit = "FILE"},
                &mask_);
    options.Add({.name = "max-motion",
                 .help = "two frames that moved more than that are not used",
                 .unit = "px",
                 .min = 0.01,
                 .max = 0.5},
                &options_.max_motion_px);
  }

  CommandReport Run(const CommonOptions& common, const std::string&) override;

 private:
  std::unique_ptr<PhotonTransferFit> Collect(ImageSequence& images, ProgressStyle style,
                                             std::vector<std::string>* problems) const;
  void Write(const PhotonTransfer& found) const;

  std::string images_, output_ = "noise.toml", camera_ = "camera", frames_, roi_, mask_;
  PhotonTransferOptions options_;
};

std::string DescribeModel(const PhotonTransfer& found) {
  const NoiseModel& model = found.model;
  const double top = std::ldexp(1.0, found.bits) - 1;
  const double middle = 0.5 * (found.lowest_grey + found.highest_grey);
  const auto sigma = [&](double grey) { return std::sqrt(model.Variance(grey)); };
  std::string text = fmt::format(
      "Noise (one standard deviation) in grey levels of 0 to {:.0f}: {:.2f} at level {:.0f}, "
      "{:.2f} "
      "at {:.0f}, {:.2f} at {:.0f}.\n",
      top, sigma(found.lowest_grey), found.lowest_grey, sigma(middle), middle,
      sigma(found.highest_grey), found.highest_grey);
  if (found.constant) {
    return text + fmt::format("Variance: {:.4g} +- {:.2g} grey levels squared, at any level.\n",
                              model.offset_grey2, found.sigma_offset_grey2());
  }
  text += fmt::format(
      "Variance = ({:.4g} +- {:.2g}) + ({:.4g} +- {:.2g}) x grey level; rounding is not in it.\n",
      model.offset_grey2, found.sigma_offset_grey2(), model.slope_grey, found.sigma_slope_grey());
  const double darkest = std::sqrt(model.Variance(0) + kRoundingVarianceGrey2);
  text += fmt::format(
      "If these are raw levels: {:.3g} grey levels an electron, so that white is about {:.2g} "
      "electrons;\n  dynamic range {:.0f} dB, signal to noise at white {:.0f}.\n",
      model.slope_grey, top / model.slope_grey, 20 * std::log10(top / darkest), top / sigma(top));
  return text;
}

nlohmann::json JsonOf(const PhotonTransfer& found) {
  nlohmann::json curve = nlohmann::json::array();
  for (const PhotonTransferPoint& p : found.curve) {
    curve.push_back({{"grey", p.grey},
                     {"variance_grey2", p.variance_grey2},
                     {"sigma_grey2", p.sigma_grey2},
                     {"pixels", p.pixels}});
  }
  return {{"bits", found.bits},
          {"width", found.size.width},
          {"height", found.size.height},
          {"frames", found.frames},
          {"pairs", found.pairs},
          {"moved_pairs", found.moved_pairs},
          {"offset_grey2", found.model.offset_grey2},
          {"slope_grey", found.model.slope_grey},
          {"sigma_offset_grey2", found.sigma_offset_grey2()},
          {"sigma_slope_grey", found.sigma_slope_grey()},
          {"constant", found.constant},
          {"chi2_per_dof", found.chi2_per_dof},
          {"misfit", found.misfit},
          {"lowest_grey", found.lowest_grey},
          {"highest_grey", found.highest_grey},
          {"used_share", found.used_share},
          {"black_share", found.black_share},
          {"white_share", found.white_share},
          {"flicker", found.flicker},
          {"motion_px", found.motion_px},
          {"neighbour_correlation", found.neighbour_correlation},
          {"curve", curve}};
}

std::unique_ptr<PhotonTransferFit> NoiseCommand::Collect(ImageSequence& images, ProgressStyle style,
                                                         std::vector<std::string>* problems) const {
  const Image<std::uint8_t> mask = mask_.empty() ? Image<std::uint8_t>() : ReadMask(mask_);
  const std::optional<PixelRegion> roi =
      roi_.empty() ? std::nullopt : std::optional(PixelRegion::Parse(roi_));
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
    file.erase("camera");
  }
  file[camera_] = {.model = found.model,
                   .cov = found.cov,
                   .bits = found.bits,
                   .frames = found.frames,
                   .size = found.size,
                   .lowest_grey = found.lowest_grey,
                   .highest_grey = found.highest_grey,
                   .created = ""};
  WriteNoiseFile(output_, file);
}

CommandReport NoiseCommand::Run(const CommonOptions& common, const std::string&) {
  options_.Check();
  ImageSourceOptions source;
  source.frames = frames_;
  const auto images = OpenImageSequence(images_, source);
  std::vector<std::string> problems;
  const std::unique_ptr<PhotonTransferFit> fit = Collect(*images, common.progress(), &problems);
  if (!fit) {
    spdlog::error("Stopped; nothing was written.");
    return {"", {{"interrupted", true}}, 130};
  }
  const PhotonTransfer found = fit->Fit();
  Write(found);

  std::vector<std::string> notes = images->Notes();
  notes.insert(notes.end(), found.notes.begin(), found.notes.end());
  CommandReport report;
  report.json = JsonOf(found);
  report.json["output"] = fs::absolute(output_).string();
  report.json["notes"] = notes;
  report.json["problems"] = problems;
  report.text =
      fmt::format("{} still frames of {}x{} px, {} bits; {} of the pixels used", found.frames,
                  found.size.width, found.size.height, found.bits, Percent(found.used_share));
  if (found.black_share + found.white_share > 5e-4) {
    report.text += fmt::format(" ({} black, {} saturated)", Percent(found.black_share),
                               Percent(found.white_share));
  }
  report.text += ".\n" + DescribeModel(found);
  report.text += fmt::format(
      "Between frames the brightness changed by up to {}, and the picture moved by up to {:.2f} "
      "px; "
      "both are taken out.\n",
      Percent(found.flicker), found.motion_px);
  for (const std::string& note : notes) report.text += "Please note: " + note + ".\n";
  report.text +=
      fmt::format("Wrote {}: give it to other commands as --noise {}.\n", output_, output_);
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeNoiseCommand() { return std::make_unique<NoiseCommand>(); }

}  // namespace plumbline::internal
