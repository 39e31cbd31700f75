#pragma once

#include "calib/image.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// How many points share one noise: the sum of the correlations of one point with all others, the
// mean over the field; at least 1.
[[nodiscard]] double CorrelationArea(const NeighbourCorrelation& neighbours, ImageSize grid);

}  // namespace plumbline
