#pragma once

#include <string>
#include <vector>

#include "io/series_frame.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// How a frame of a rolling tyre was found on its wheel, and what the wheel's tags had to say.
PlacementRecord PlacementRecordOf(const RollingWheel& rolling, std::size_t frame);

// What the user should know of the tags of a run, a sentence each; none where the wheel has none.
std::vector<std::string> TagNotes(const WheelReference& wheel, const RollingWheel& rolling);

}  // namespace plumbline::internal
