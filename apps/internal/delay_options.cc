#include "apps/internal/delay_options.h"

#include <fmt/format.h>

#include "apps/internal/parse_numbers.h"
#include "calib/error.h"

namespace plumbline::internal {

void DelayOptionSet::Declare(OptionTable& options, const std::string& otherwise,
                             bool can_be_estimated) {
  can_be_estimated_ = can_be_estimated;
  options.Add({.name = "right-delay",
               .help = fmt::format(
                   "by how much the right camera exposes later than the left one, as 0.02, or with "
                   "the standard deviation of that as 0.02,0.002{}; empty: {}",
                   can_be_estimated ? "; estimate: what the recording itself says" : "", otherwise),
               .unit = "ms"},
              &text_);
}

std::optional<RightDelay> DelayOptionSet::Delay() const {
  if (!given() || estimate()) return std::nullopt;
  const auto ms = ParseNumbers(text_, ',');
  if (!ms || ms->size() > 2) {
    throw UsageError(fmt::format(
        "The right camera's delay is a number of ms, as 0.02, or that and its standard deviation, "
        "as 0.02,0.002{}, not '{}'.",
        can_be_estimated_ ? ", or estimate" : "", text_));
  }
  RightDelay delay;
  delay.value_s = 1e-3 * ms->front();
  if (ms->size() == 2) delay.sigma_s = 1e-3 * ms->back();
  delay.Check();
  return delay;
}

}  // namespace plumbline::internal
