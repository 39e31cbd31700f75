#pragma once

#include <filesystem>
#include <string>

#include "io/internal/series_datasets.h"
#include "io/planar_series.h"

namespace plumbline::internal {

// Throws std::invalid_argument on what is none of those named in PlanarSeriesHeader, or out of
// range.
void CheckPlanarHeader(const PlanarSeriesHeader& header);

// Writes header.h5: everything of the series but its frames. Throws hdf5::Error.
void WritePlanarHeader(const std::filesystem::path& file, const PlanarSeriesHeader& header);

// All of it but the recipe and the inputs. Throws hdf5::Error.
PlanarSeriesHeader ReadPlanarHeader(hid_t file, const GridFacts& grid);

// What the attribute `reference` of /displacement may say.
bool IsPlanarReference(const std::string& text);

}  // namespace plumbline::internal
