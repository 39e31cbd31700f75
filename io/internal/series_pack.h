#pragma once

#include <filesystem>
#include <string>

#include "io/series_writer.h"

namespace plumbline::internal {

// What lies in a run's parts folder.
std::filesystem::path PartsFolder(const std::filesystem::path& series);
std::filesystem::path JournalFile(const std::filesystem::path& series);
std::filesystem::path HeaderFile(const std::filesystem::path& series);

// Packs the parts into the series and removes them. `inputs`: what DescribeInputs() gives; empty:
// it is made here from the paths in the journal. lock: refuse if somebody else is writing.
// Throws InputError, EnvironmentError.
RecoveredSeries PackSeries(const std::filesystem::path& series, const std::string& inputs,
                           bool lock);

}  // namespace plumbline::internal
