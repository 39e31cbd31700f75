#pragma once

#include <filesystem>
#include <string>

#include "io/series_writer.h"

namespace plumbline::internal {

// Packs the parts into the series and removes them. `inputs`: what DescribeInputs() gives; empty:
// it is made here from the paths in the journal. lock: refuse if somebody else is writing.
// Throws InputError, EnvironmentError.
RecoveredSeries PackSeries(const std::filesystem::path& series, const std::string& inputs,
                           bool lock);

}  // namespace plumbline::internal
