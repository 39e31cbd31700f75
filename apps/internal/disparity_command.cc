#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "apps/internal/command.h"
#include "calib/error.h"
#include "calib/median.h"
#include "io/disparity_file.h"
#include "io/disparity_hdf5.h"
#include "io/image_source.h"
#include "match/disparity.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

// What is to be told of a disparity map.
struct DisparitySummary {
  std::int64_t pixels = 0, valid = 0;
  double smallest_px = 0, largest_px = 0, median_sigma_px = 0;
};

DisparitySummary Summarise(const DisparityMap& map) {
  DisparitySummary summary;
  std::vector<float> sigmas;
  float low = INFINITY;
  float high = -INFINITY;
  for (std::size_t i = 0; i < map.status.pixel_count(); ++i) {
    if (map.status.values()[i] != Status::kOk) continue;
    low = std::min(low, map.value_px.values()[i]);
    high = std::max(high, map.value_px.values()[i]);
    sigmas.push_back(map.sigma_px.values()[i]);
  }
  summary.pixels = static_cast<std::int64_t>(map.status.pixel_count());
  summary.valid = static_cast<std::int64_t>(sigmas.size());
  if (sigmas.empty()) return summary;
  summary.smallest_px = low;
  summary.largest_px = high;
  summary.median_sigma_px = Median(std::move(sigmas));
  return summary;
}

class DisparityCommand : public Command {
 public:
  std::string Name() const override { return "disparity"; }
  std::string Summary() const override {
    return "Disparity, with its sigma, of a pair that is rectified already.";
  }
  std::string Footer() const override {
    return "The left pixel (x, y) is seen at (x - disparity, y) in the right image.\n"
           "  .h5   value, sigma and status of each pixel\n"
           "  .png  16 bit, disparity * 256 where that fits (KITTI's convention), 0 where there is "
           "none\n"
           "  .pfm  32-bit floats, inf where there is none (Middlebury's convention)\n"
           "Example:\n"
           "  plumbline disparity left.png right.png -o disparity.h5";
  }

  void Declare(OptionTable& options) override {
    options.Add(
        {.name = "LEFT", .help = "left rectified image", .required = true, .positional = true},
        &left_);
    options.Add(
        {.name = "RIGHT", .help = "right rectified image", .required = true, .positional = true},
        &right_);
    options.Add({.name = "output",
                 .help = "where the result goes: .h5, .png or .pfm",
                 .unit = "FILE",
                 .short_name = "o"},
                &output_);
    options.Add({.name = "method",
                 .help = "sgbm carries values over weak texture, bm is faster",
                 .choices = {"sgbm", "bm"}},
                &method_);
    options.Add({.name = "min-disparity",
                 .help = "smallest disparity to look for; auto: found from the images",
                 .unit = "px"},
                &options_.min_disparity_px);
    options.Add({.name = "max-disparity", .help = "largest one", .unit = "px"},
                &options_.max_disparity_px);
    options.Add({.name = "block",
                 .help = "side of the matcher's block, odd; 0: the matcher's own",
                 .unit = "px",
                 .min = 0,
                 .max = 255},
                &options_.block_px);
    options.Add({.name = "uniqueness",
                 .help = "by how much the best match must beat the second best",
                 .unit = "%",
                 .min = 0,
                 .max = 100},
                &options_.uniqueness_percent);
    options.Add({.name = "left-right-tolerance",
                 .help = "by how much the matches from left and from right may differ",
                 .unit = "px",
                 .min = 0},
                &options_.left_right_tolerance_px);
  }

  CommandReport Run(const CommonOptions&, const std::string& recipe_toml) override {
    DisparityOptions options = options_;
    options.method = method_ == "bm" ? DisparityMethod::kBm : DisparityMethod::kSgbm;
    options.Check();
    const std::string extension = fs::path(output_).extension().string();
    if (extension != ".h5" && extension != ".hdf5" && extension != ".png" && extension != ".pfm") {
      throw UsageError(fmt::format(
          "A disparity map is written as .h5, .png or .pfm; '{}' ends in none of these.", output_));
    }
    const GrayImage left = ReadImage(left_);
    const GrayImage right = ReadImage(right_);
    const DisparityMap map = ComputeDisparity(left, right, options);
    std::string scale_note;
    if (extension == ".png") {
      const DisparityPngScale scale = ChooseDisparityPngScale(map.value_px);
      WriteDisparityPng(output_, map.value_px, scale);
      scale_note = fmt::format(" Disparity = grey / {} + {} px; grey 0: none.", scale.steps_per_px,
                               scale.offset_px);
    } else if (extension == ".pfm") {
      WritePfm(output_, map.value_px);
    } else {
      WriteDisparityHdf5(output_, map, recipe_toml, {left_, right_});
    }

    const DisparitySummary s = Summarise(map);
    CommandReport report;
    report.json = {{"output", fs::absolute(output_).string()},
                   {"pixels", s.pixels},
                   {"valid_pixels", s.valid},
                   {"searched_px", {map.min_disparity_px, map.max_disparity_px}}};
    if (s.valid > 0) {
      report.json["disparity_px"] = {s.smallest_px, s.largest_px};
      report.json["median_sigma_px"] = s.median_sigma_px;
    }
    report.text = fmt::format(
        "{} of {} pixels have a disparity ({:.1f} %), searched from {} to {} px.\n", s.valid,
        s.pixels, 100.0 * static_cast<double>(s.valid) / static_cast<double>(s.pixels),
        map.min_disparity_px, map.max_disparity_px);
    if (s.valid > 0) {
      report.text +=
          fmt::format("They run from {:.2f} to {:.2f} px; median standard deviation {:.3f} px.\n",
                      s.smallest_px, s.largest_px, s.median_sigma_px);
    }
    report.text += fmt::format("Wrote {}.{}\n", output_, scale_note);
    if (s.valid == 0) report.exit_code = 3;
    return report;
  }

 private:
  std::string left_, right_, output_ = "disparity.h5", method_ = "sgbm";
  DisparityOptions options_;
};

}  // namespace

std::unique_ptr<Command> MakeDisparityCommand() { return std::make_unique<DisparityCommand>(); }

}  // namespace plumbline::internal
