#include "track/right_delay.h"

#include <cmath>

#include "calib/error.h"

namespace plumbline {

void RightDelay::Check() const {
  if (!(std::abs(value_s) <= kMost_s)) {
    throw UsageError("The right camera may expose up to 1 ms earlier or later than the left one.");
  }
  if (!(sigma_s >= 0 && sigma_s <= kMost_s)) {
    throw UsageError("The sigma of the right camera's delay is 0 to 1 ms.");
  }
}

}  // namespace plumbline
