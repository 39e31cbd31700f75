#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/internal/channel_options.h"
#include "apps/internal/command.h"
#include "apps/internal/contact_options.h"
#include "apps/internal/option_table.h"
#include "apps/internal/rolling_options.h"
#include "apps/internal/stereo_options.h"
#include "apps/rolling_run.h"
#include "io/series_reader.h"

namespace plumbline::internal {

// What `analyse` of a rolling tyre's run has beside the options of evaluation.
struct RollingAnalysisOptionSet {
  void Declare(OptionTable& options);
  // Takes from the recipe of a run what is not given: it stays as it was measured, or analysed
  // last.
  void Complete(const std::string& recipe_toml, OptionTable& options) const;

  RollingOptionSet rolling;
  ContactOptionSet contact;
  ChannelOptionSet channels;
};

// A rolling tyre's run, to be told again frame by frame (RollingRun::MeasureAgain).
struct RollingAnalysis {
  std::unique_ptr<RollingRun> run;
  SeriesHeader header;  // but for the recipe and the run's own file
  std::vector<std::string> notes;
};

// From the file of a run and the wheel that it was measured against: the survey again, the ground
// and the contact. Nothing: stopped. Throws InputError saying what is missing, and as RollingRun.
std::optional<RollingAnalysis> AnalyseRolling(const SeriesReader& series, const std::string& file,
                                              const EvaluationOptionSet& evaluation,
                                              const RollingAnalysisOptionSet& options,
                                              const CommonOptions& common);

}  // namespace plumbline::internal
