#pragma once

#include "calib/image.h"
#include "match/neighbour_correlation.h"

namespace plumbline::internal {

// How many points share one noise: the sum of the correlations of one point with all others, the
// mean over the field.
double CorrelationArea(const NeighbourCorrelation& neighbours, ImageSize grid);

}  // namespace plumbline::internal
