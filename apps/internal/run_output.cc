#include "apps/internal/run_output.h"

#include <fmt/format.h>

#include "apps/internal/measure_report.h"
#include "calib/error.h"
#include "io/series_start.h"

namespace plumbline::internal {

std::optional<CommandReport> FinishedRun(const std::filesystem::path& output,
                                         const std::string& output_name,
                                         const std::string& recipe_toml) {
  const RunState state = FindRun(output);
  if (state.kind != RunState::Kind::kFinished) return std::nullopt;
  if (RecipeOfTheData(state.recipe_toml) != RecipeOfTheData(recipe_toml)) {
    throw InputError(fmt::format(
        "'{}' is finished and was made with other settings; choose another name with -o, or say "
        "--overwrite instead of --resume.",
        output_name));
  }
  CommandReport report;
  report.text = fmt::format("{} is finished: {} frames. Nothing was left to do.\n", output_name,
                            state.frames);
  report.json = {{"output", output.string()}, {"frames_read", state.frames}, {"finished", true}};
  return report;
}

void CommitFrame(const SeriesFrame& frame, const std::filesystem::path& output,
                 SeriesWriter& writer) {
  try {
    writer.Commit(frame);
  } catch (const EnvironmentError& error) {
    if (writer.committed() == 0) throw;
    throw EnvironmentError(
        fmt::format("{}; make room: {}", error.what(), KeptText(writer.committed(), output)));
  }
}

}  // namespace plumbline::internal
