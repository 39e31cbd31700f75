#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/internal/stereo_options.h"
#include "apps/stereo_run.h"
#include "io/series_reader.h"

namespace plumbline::internal {

// How the images of a run were matched: the options of `measure` in the recipe of its file.
class RecordedMatching {
 public:
  // file: of the run, for what is said. Throws InputError where the recipe is none of `measure`, or
  // where a file that it names (mask, noise) is not there any more, or another one.
  RecordedMatching(const SeriesReader& series, const std::string& file);

  // bits: of the images, for the noise.
  StereoRunOptions Options(const SurfaceEvaluationOptions& evaluation, int bits) const;
  bool order_given() const { return dic_.order_given(); }
  std::uint64_t seed() const { return seed_; }
  const std::vector<std::filesystem::path>& files() const { return files_; }  // that it names

 private:
  StereoOptionSet dic_;
  std::optional<int> step_px_;
  std::string roi_, mask_;
  std::uint64_t seed_ = 1;
  std::vector<std::filesystem::path> files_;
};

}  // namespace plumbline::internal
