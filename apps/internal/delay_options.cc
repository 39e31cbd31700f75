#include "apps/internal/delay_options.h"

#include <fmt/format.h>

#include <charconv>
#include <system_error>

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
  const auto refuse = [&] {
    return UsageError(fmt::format(
        "The right camera's delay is a number of ms, as 0.02, or that and its standard deviation, "
        "as 0.02,0.002{}, not '{}'.",
        can_be_estimated_ ? ", or estimate" : "", text_));
  };
  RightDelay delay;
  const char* const end = text_.data() + text_.size();
  std::from_chars_result read = std::from_chars(text_.data(), end, delay.value_s);
  if (read.ec == std::errc() && read.ptr != end && *read.ptr == ',') {
    read = std::from_chars(read.ptr + 1, end, delay.sigma_s);
  }
  if (read.ec != std::errc() || read.ptr != end) throw refuse();
  delay.value_s *= 1e-3;
  delay.sigma_s *= 1e-3;
  delay.Check();
  return delay;
}

}  // namespace plumbline::internal
