#pragma once

#include <filesystem>
#include <string>

#include "io/internal/journal.h"
#include "io/internal/point_layout.h"
#include "io/series_writer.h"

namespace plumbline::internal {

// Writes a series with the next frames of the journal, at most so many. header: header.h5.
// `inputs`: its attribute. Returns how many frames there were. Throws hdf5::Error,
// std::filesystem::filesystem_error.
std::int64_t PackRecords(const std::filesystem::path& file, const std::filesystem::path& header,
                         JournalReader& journal, const SeriesShape& shape, std::int64_t most,
                         const std::string& inputs);

// Packs the parts into the series and removes them. `inputs`: what DescribeInputs() gives; empty:
// it is made here from the paths in the journal. lock: refuse if somebody else is writing.
// Throws InputError, EnvironmentError.
RecoveredSeries PackSeries(const std::filesystem::path& series, const std::string& inputs,
                           bool lock);

}  // namespace plumbline::internal
