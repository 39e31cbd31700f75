#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "io/planar_series.h"
#include "io/series_reader.h"
#include "match/neighbour_correlation.h"

namespace plumbline::internal {

// How the errors of a series' points go together.
struct SeriesNeighbours {
  NeighbourCorrelation correlation;
  std::string note;  // empty where it is exact, from the reference image; else what it is, and why
  std::vector<std::filesystem::path> files;  // it was found from
};

// From the reference image, where it is still where the run read it (recorded path and SHA-256,
// and that of the mask); else from the overlap of the subsets alone.
SeriesNeighbours NeighboursOf(const PlanarSeriesHeader& header, const std::string& inputs_json);

// Of a stereo-DIC run; reference_id: the left image of its reference pair.
SeriesNeighbours NeighboursOf(const SeriesReader& series, const std::string& reference_id);

}  // namespace plumbline::internal
