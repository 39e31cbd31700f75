#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "apps/internal/command.h"
#include "apps/region.h"
#include "calib/error.h"
#include "io/image_source.h"
#include "io/noise_file.h"
#include "match/speckle_check.h"

namespace plumbline::internal {
namespace {

class SpeckleCommand : public Command {
 public:
  std::string Name() const override { return "speckle"; }
  std::string Summary() const override {
    return "Before measuring: is this image's speckle fit for correlation, and how good will it "
           "be?";
  }
  std::string Footer() const override {
    return "Looks at one image, usually the reference, and predicts the noise of the "
           "displacements.\n"
           "Examples:\n"
           "  plumbline speckle reference.png --subset 33 --noise noise.toml\n"
           "  plumbline speckle reference.png --roi 100,80,900,600 --wanted-sigma 0.005";
  }

  void Declare(OptionTable& options) override {
    options.Add({.name = "IMAGE", .help = "the image", .required = true, .positional = true},
                &image_);
    options.Add(
        {.name = "noise",
         .help = "noise file of plumbline noise; without, noise is estimated from the image",
         .unit = "FILE"},
        &noise_);
    options.Add({.name = "camera",
                 .help = "whose noise to take, where the file has several",
                 .choices = {"camera", "left", "right"}},
                &camera_);
    options.Add({.name = "subset", .help = "side of the subset, odd", .unit = "px"},
                &options_.subset_px);
    options.Add({.name = "step",
                 .help = "between the points looked at; 0: half a subset",
                 .unit = "px",
                 .min = 0},
                &options_.step_px);
    options.Add(
        {.name = "wanted-sigma",
         .help = "standard deviation of a displacement that a subset is looked for to reach",
         .unit = "px"},
        &options_.wanted_sigma_px);
    options.Add({.name = "roi", .help = "only this part of the image", .unit = "x,y,w,h"}, &roi_);
    options.Add({.name = "mask", .help = "image that is 0 where not to look", .unit = "FILE"},
                &mask_);
    options.Add({.name = "points", .help = "with --json: list every point, too"}, &points_);
  }

  CommandReport Run(const CommonOptions& common, const std::string& recipe_toml) override;

 private:
  std::string image_, noise_, camera_ = "camera", roi_, mask_;
  bool points_ = false;
  SpeckleCheckOptions options_;
};

nlohmann::json NumberOrNull(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

nlohmann::json PointsOf(const SpeckleCheck& check) {
  nlohmann::json points = nlohmann::json::array();
  for (const SpecklePoi& poi : check.pois) {
    points.push_back({{"x", poi.centre_px.x()},
                      {"y", poi.centre_px.y()},
                      {"status", Name(poi.status)},
                      {"cov_xx_px2", NumberOrNull(poi.cov_px2(0, 0))},
                      {"cov_xy_px2", NumberOrNull(poi.cov_px2(0, 1))},
                      {"cov_yy_px2", NumberOrNull(poi.cov_px2(1, 1))},
                      {"sigma_px", NumberOrNull(poi.sigma_px)},
                      {"smallest_subset_px", poi.smallest_subset_px}});
  }
  return points;
}

nlohmann::json JsonOf(const SpeckleCheck& check) {
  nlohmann::json weak = nlohmann::json::array();
  for (const WeakRegion& region : check.weak) {
    weak.push_back({{"where", region.where},
                    {"roi_px", {region.x, region.y, region.width, region.height}},
                    {"pois", region.pois},
                    {"sigma_px", NumberOrNull(region.sigma_px)}});
  }
  return {{"pixels", check.pixels},
          {"mean_grey", check.mean_grey},
          {"contrast_grey", check.contrast_grey},
          {"black_share", check.black_share},
          {"white_share", check.white_share},
          {"mean_gradient_grey", check.mean_gradient_grey},
          {"feature_px", NumberOrNull(check.feature_px)},
          {"blur_px", NumberOrNull(check.blur_px)},
          {"noise",
           {{"offset_grey2", check.noise.offset_grey2},
            {"slope_grey", check.noise.slope_grey},
            {"estimated", check.noise_estimated}}},
          {"measurable_pois", check.measurable_pois},
          {"median_sigma_px", NumberOrNull(check.median_sigma_px)},
          {"sigma95_px", NumberOrNull(check.sigma95_px)},
          {"subset_for_wanted_px", check.subset_for_wanted_px},
          {"weak_regions", weak},
          {"advice", check.advice}};
}

std::string Px(double value, const char* unknown) {
  return std::isfinite(value) ? fmt::format("{:.1f} px", value) : unknown;
}

std::string Describe(const SpeckleCheck& check, const SpeckleCheckOptions& options) {
  const double noise = std::sqrt(check.noise.Variance(check.mean_grey));
  std::string text = fmt::format(
      "Feature size {} (3 to 7 is good); edges as sharp as a blur of {} (0.3 to 0.6 is sharp).\n",
      Px(check.feature_px, "unknown"), Px(check.blur_px, "unknown size"));
  text += fmt::format(
      "Grey level {:.0f} on average, contrast {:.1f}, mean gradient {:.1f} a px; {:.1f} % black, "
      "{:.1f} % saturated.\n",
      check.mean_grey, check.contrast_grey, check.mean_gradient_grey, 100 * check.black_share,
      100 * check.white_share);
  text +=
      fmt::format("Noise at that level: {:.2f} grey levels ({}).\n", noise,
                  check.noise_estimated
                      ? "estimated from this image; plumbline noise finds it better, from still "
                        "frames"
                      : "from the noise file");
  std::int64_t looked_at = 0;
  for (const SpecklePoi& poi : check.pois) looked_at += poi.status != Status::kMasked;
  if (check.measurable_pois > 0) {
    text += fmt::format(
        "With subsets of {} px a displacement will have a standard deviation of {:.4f} px at the "
        "median\n  and {:.4f} px at the 95th percentile of the points that have texture ({} of "
        "{}), "
        "in the worse direction,\n  from noise in both images; about 1.9 times that with "
        "second-order shape functions.\n",
        options.subset_px, check.median_sigma_px, check.sigma95_px, check.measurable_pois,
        looked_at);
  }
  if (check.subset_for_wanted_px > 0) {
    text +=
        fmt::format("The smallest subset that reaches {:.2g} px at 95 % of the points: {} px.\n",
                    options.wanted_sigma_px, check.subset_for_wanted_px);
  }
  for (const WeakRegion& region : check.weak) {
    text += fmt::format("Weak: {}, region {},{},{},{} ({} of {} points): {}.\n", region.where,
                        region.x, region.y, region.width, region.height, region.pois, looked_at,
                        std::isfinite(region.sigma_px)
                            ? fmt::format("standard deviation {:.3f} px", region.sigma_px)
                            : "no texture above the noise");
  }
  for (const std::string& sentence : check.advice) text += "Please note: " + sentence + ".\n";
  if (check.advice.empty() && check.weak.empty()) text += "Nothing to complain about.\n";
  return text;
}

CommandReport SpeckleCommand::Run(const CommonOptions&, const std::string&) {
  SpeckleCheckOptions options = options_;
  options.largest_subset_px = std::max(options.largest_subset_px, options.subset_px);
  options.Check();
  const std::optional<PixelRegion> roi =
      roi_.empty() ? std::nullopt : std::optional(PixelRegion::Parse(roi_));
  bool was_colour = false;
  const GrayImage image = ReadImage(image_, &was_colour);
  if (was_colour) spdlog::info("Note: {} is in colour; looked at is its grey value.", image_);
  const Image<std::uint8_t> mask = mask_.empty() ? Image<std::uint8_t>() : ReadMask(mask_);
  const Image<std::uint8_t> wanted = WantedPixels(image.size(), roi, mask);
  if (!noise_.empty()) {
    const CameraNoise noise = ReadCameraNoise(noise_, camera_);
    options.noise = noise.ForBits(image.bits);
    if (noise.size.width > 0 && !(noise.size == image.size())) {
      spdlog::info("Note: the noise was found in images of {}x{} px, and this one has {}x{}.",
                   noise.size.width, noise.size.height, image.width(), image.height());
    }
  }
  const SpeckleCheck check = CheckSpeckle(image, options, wanted);
  CommandReport report;
  report.json = JsonOf(check);
  if (points_) report.json["points"] = PointsOf(check);
  report.json["image"] = image_;
  report.json["subset_px"] = options.subset_px;
  report.json["wanted_sigma_px"] = options.wanted_sigma_px;
  report.text =
      fmt::format("{}: {}x{} px, {} bits.\n", image_, image.width(), image.height(), image.bits) +
      Describe(check, options);
  if (check.measurable_pois == 0) report.exit_code = 3;
  return report;
}

}  // namespace

std::unique_ptr<Command> MakeSpeckleCommand() { return std::make_unique<SpeckleCommand>(); }

}  // namespace plumbline::internal
