#include "apps/internal/rolling_analysis.h"

#include <fmt/format.h>

#include <utility>

#include "apps/internal/recorded_input.h"
#include "apps/internal/recorded_matching.h"
#include "apps/internal/wheel_lean.h"
#include "apps/interrupt.h"
#include "calib/error.h"
#include "io/file_hash.h"
#include "io/series_start.h"
#include "io/wheel_file.h"
#include "track/right_flow.h"

namespace plumbline::internal {
namespace {

namespace fs = std::filesystem;

void CheckWhole(const SeriesReader& series, const std::string& file) {
  if (!series.contents().survey) {
    throw InputError(fmt::format(
        "'{}' was written by {}, which did not keep what the wheel's angle and the ground follow "
        "from (/survey): measure again with the other settings.",
        file, series.facts().software));
  }
  if (const std::optional<SeriesShard>& shard = series.facts().shard) {
    throw InputError(fmt::format(
        "'{}' is part {} of {} of a run, and the wheel's angle and the ground follow from all of "
        "it: join the parts with plumbline merge and analyse the whole.",
        file, shard->index + 1, shard->count));
  }
}

// The wheel's reference that the run was measured against, and no other.
fs::path WheelFileOf(const SeriesReader& series, const std::string& file,
                     const RollingOptionSet& rolling) {
  const SeriesFacts& facts = series.facts();
  if (!rolling.given()) {
    std::string why;
    const std::string name = RecipeText(facts.recipe_toml, "measure", "reference");
    if (const auto path = UnchangedInput(facts.inputs_json, name, &why)) return *path;
    // An analysis may have had it by another name.
    for (const RecordedInput& input : InputsOf(facts.inputs_json)) {
      if (IsWheelFile(input.path) && FileSha256(input.path) == input.sha256) return input.path;
    }
    throw InputError(fmt::format(
        "The wheel's reference that '{}' was measured against is needed, but {}: say where it is "
        "with --reference.",
        file, why));
  }
  if (!fs::is_regular_file(rolling.file())) {
    throw InputError(fmt::format("There is no file '{}'.", rolling.file()));
  }
  if (!IsRecordedInput(facts.inputs_json, FileSha256(rolling.file()))) {
    throw InputError(fmt::format(
        "'{}' is not the wheel's reference that '{}' was measured against (its SHA-256 is another "
        "one): give that one with --reference.",
        rolling.file(), file));
  }
  return rolling.file();
}

// Then there is nothing left in the matches that would tell it again.
bool DelayWasEstimated(const SeriesReader& series) {
  const std::optional<RightDelay>&used = series.right_delay(),
        &told = series.estimated_right_delay();
  return used && told && used->value_s == told->value_s && used->sigma_s == told->sigma_s;
}

// With the modes of what may be wrong beside the calibration, as when it was measured.
WheelReference WheelOf(const fs::path& path, const RightDelay& delay,
                       const ContactOptionSet& contact) {
  WheelReference wheel = RollingOptionSet::WheelOf(path.string());
  return contact.WithCarcass(WithDelayMode(std::move(wheel), delay));
}

}  // namespace

void RollingAnalysisOptionSet::Declare(OptionTable& options) {
  rolling.Declare(
      options,
      "of a rolling tyre: the undeformed wheel that it was measured against, where that "
      "file is not any more where it was");
  contact.Declare(options);
  channels.Declare(options);
}

void RollingAnalysisOptionSet::Complete(const std::string& recipe_toml,
                                        OptionTable& options) const {
  // What is of the command, or of a place on a disk; and strain can be had of any run.
  const std::vector<std::string> without = {"FILE",      "output",   "overwrite", "threads",
                                            "reference", "channels", "no-strain"};
  options.ReadStored(recipe_toml, "analyse", without);
  options.ReadStored(recipe_toml, "measure", without);
}

std::optional<RollingAnalysis> AnalyseRolling(const SeriesReader& series, const std::string& file,
                                              const EvaluationOptionSet& evaluation,
                                              const RollingAnalysisOptionSet& options,
                                              const CommonOptions& common) {
  CheckWhole(series, file);
  const RecordedMatching matching(series, file);
  std::vector<Channel> channels = options.channels.ReadOr(series.channels());
  options.contact.CheckChannels(channels);
  const fs::path wheel_file = WheelFileOf(series, file, options.rolling);
  RightDelay delay = series.right_delay().value_or(RightDelay{});
  // Without modes its sigma does nothing but stand in the file.
  if (series.rig().modes.count() == 0) delay.sigma_s = 0;
  WheelReference wheel = WheelOf(wheel_file, delay, options.contact);

  RollingRunOptions run_options = options.rolling.Options(
      matching.Options(evaluation.Options(matching.seed(), true), wheel.views.front().left.bits),
      matching.order_given());
  run_options.survey.images = false;
  run_options.right_delay = delay;
  auto again = std::make_unique<RollingRun>(std::move(wheel), run_options);
  RollingRun& run = *again;
  RollingContactOptions contact = options.contact.Options(run.reference().profile.crown_y_mm);
  std::optional<Progress> progress(std::in_place, "finding the wheel", series.frame_count(),
                                   common.progress());
  const bool whole = run.SurveyAgain(
      series.frame_count(), [&](std::int64_t i) { return series.SurveyedFrame(i); },
      [&](std::int64_t done, std::int64_t) {
        if (done > 0) progress->Advance();
        return !InterruptGuard::Requested();
      });
  progress.reset();
  if (!whole) return std::nullopt;
  const std::string clock = FindContact(options.contact, std::move(contact), run, &channels);
  RollingAnalysis analysis{std::move(again), run.Header(), run.Notes()};
  analysis.header.right_delay = series.right_delay();
  if (DelayWasEstimated(series)) {
    analysis.header.estimated_right_delay = series.estimated_right_delay();
  }
  analysis.header.channels = std::move(channels);
  analysis.header.inputs = {wheel_file};
  for (const fs::path& used : matching.files()) analysis.header.inputs.push_back(used);
  if (!options.channels.file().empty()) {
    analysis.header.inputs.emplace_back(options.channels.file());
  }
  if (!clock.empty()) analysis.notes.push_back(clock);
  if (series.frame_count() < series.surveyed_frames()) {
    analysis.notes.push_back(fmt::format(
        "'{}' holds {} of the {} frames of its recording; the wheel's angle and the ground follow "
        "from these alone.",
        file, series.frame_count(), series.surveyed_frames()));
  }
  return analysis;
}

}  // namespace plumbline::internal
