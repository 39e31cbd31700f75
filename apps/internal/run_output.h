#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "apps/internal/command.h"
#include "io/series_writer.h"

namespace plumbline::internal {

// Where a run is finished already: what there is to say of that. output_name: as the user said it.
// Throws InputError where it was made with other settings.
std::optional<CommandReport> FinishedRun(const std::filesystem::path& output,
                                         const std::string& output_name,
                                         const std::string& recipe_toml);

// Throws EnvironmentError; where there is no room for the frame, with what is kept and how to go
// on.
void CommitFrame(const SeriesFrame& frame, const std::filesystem::path& output,
                 SeriesWriter& writer);

}  // namespace plumbline::internal
