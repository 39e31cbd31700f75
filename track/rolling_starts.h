#pragma once

#include <cstddef>

#include "match/stereo_sequence.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline {

// Where a correlation of a rolling wheel's images may start, so that nothing has to be searched.

// The right image of a view's pair, out of the view's points and what lies between them; to some
// tenths of a pixel. Keeps references to both.
[[nodiscard]] RightPlace RightPlaceOf(const WheelReference& wheel, const WheelReferenceView& view);

// The points of a frame that is placed, and what lies between them on the survey's grid, as points
// of another grid in the left image of the same view.
// Returns: kOk where the four points around are known; the rest is left to their neighbours.
[[nodiscard]] StereoField StartsOf(const RollingWheel& rolling, std::size_t frame,
                                   const PlanarField& grid);

}  // namespace plumbline
