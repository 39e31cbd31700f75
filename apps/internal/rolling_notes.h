#pragma once

#include <string>
#include <vector>

#include "track/right_delay.h"
#include "track/right_delay_estimate.h"
#include "track/rolling_contact.h"

namespace plumbline::internal {

// What a run of a rolling tyre says of its own at its end, in sentences.

// How much later the right camera exposes by the images, and whether that contradicts what was
// taken out.
[[nodiscard]] std::string DelayNote(const RightDelayEstimate& estimate, const RightDelay& used);

// What the contact says of the carcass; nothing where it agrees with what was said and has no more
// to tell. middle_y_mm: of the tread, along the wheel's axis.
[[nodiscard]] std::vector<std::string> CarcassNotes(const RollingContact& contact,
                                                    double middle_y_mm);

}  // namespace plumbline::internal
