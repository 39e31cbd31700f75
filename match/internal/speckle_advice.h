#pragma once

#include "match/speckle_check.h"

namespace plumbline::internal {

// Groups the POIs that stand out, and names where they are.
void FindWeakRegions(const SpeckleCheckOptions& options, ImageSize size, int poi_columns,
                     SpeckleCheck& check);

// What to do about all that is not as it should be.
void AddSpeckleAdvice(const SpeckleCheckOptions& options, int bits, SpeckleCheck& check);

}  // namespace plumbline::internal
