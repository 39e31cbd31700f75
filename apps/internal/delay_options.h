#pragma once

#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "track/right_delay.h"

namespace plumbline::internal {

// By how much the right camera exposes later.
class DelayOptionSet {
 public:
  // otherwise: what goes where the option is left out; can_be_estimated: by what is measured.
  void Declare(OptionTable& options, const std::string& otherwise, bool can_be_estimated);

  bool given() const { return !text_.empty(); }
  bool estimate() const { return can_be_estimated_ && text_ == kEstimate; }
  // Nothing where it was not said, or is to be estimated. Throws UsageError.
  std::optional<RightDelay> Delay() const;

 private:
  static constexpr const char* kEstimate = "estimate";

  std::string text_;
  bool can_be_estimated_ = false;
};

}  // namespace plumbline::internal
