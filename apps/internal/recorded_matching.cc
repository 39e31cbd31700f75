#include "apps/internal/recorded_matching.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>

#include "apps/internal/option_table.h"
#include "apps/internal/recorded_input.h"
#include "apps/region.h"
#include "calib/error.h"

namespace plumbline::internal {

RecordedMatching::RecordedMatching(const SeriesReader& series, const std::string& file) {
  constexpr const char* kCommand = "measure";
  CLI::App app;
  OptionTable options(app, kCommand);
  options.Add({.name = "step", .help = ""}, &step_px_);
  options.Add({.name = "roi", .help = ""}, &roi_);
  options.Add({.name = "mask", .help = ""}, &mask_);
  options.Add({.name = "seed", .help = ""}, &seed_);
  dic_.Declare(options);
  if (!options.ReadStored(series.facts().recipe_toml, kCommand)) {
    throw InputError(fmt::format(
        "'{}' has no recipe of plumbline measure, which tells how its images were matched; measure "
        "again with the other settings.",
        file));
  }
  for (const char* name : {"mask", "noise"}) {
    const std::string text = options.Text(name).value_or("");
    if (text.empty()) continue;
    std::string why;
    const auto path = UnchangedInput(series.facts().inputs_json, text, &why);
    if (!path) {
      throw InputError(fmt::format("'{}' was measured with --{} {}, which is needed again: {}.",
                                   file, name, text, why));
    }
    options.Set(name, path->string());
    files_.push_back(*path);
  }
  options.Finish();
}

StereoRunOptions RecordedMatching::Options(const SurfaceEvaluationOptions& evaluation,
                                           int bits) const {
  StereoRunOptions options = dic_.Options(seed_, bits, step_px_.value_or(8), evaluation);
  if (!roi_.empty()) options.roi = PixelRegion::Parse(roi_);
  if (!mask_.empty()) options.mask = ReadMask(mask_);
  return options;
}

}  // namespace plumbline::internal
