#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "io/series_writer.h"

namespace plumbline::internal {

// Throws std::invalid_argument on an attribute that is none of those named in SeriesHeader,
// InputError on a channel that cannot be stored.
void CheckSeriesHeader(const SeriesHeader& header);

// Throws std::invalid_argument where it is not one of ShardOf().
void CheckShard(const std::optional<SeriesShard>& shard);

// Writes header.h5: everything of the series but its frames. Throws hdf5::Error.
void WriteSeriesHeader(const std::filesystem::path& file, const SeriesHeader& header);

// What the attributes `points` of /grid, `reference` of /displacement, `measure` and `strain_axes`
// of /strain may say.
bool IsGridPoints(const std::string& text);
bool IsDisplacementReference(const std::string& text);
bool IsStrainMeasure(const std::string& text);
bool IsStrainAxes(const std::string& text);

// Place of the first time that is no number or before the one before it; the size if there is none.
std::size_t FirstWrongTime(const std::vector<double>& time_s);

}  // namespace plumbline::internal
