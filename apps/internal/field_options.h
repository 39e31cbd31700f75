#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "match/correlate_field.h"

namespace plumbline::internal {

// "low-pass", "none", or the sigma of a Gaussian in px. Throws UsageError.
void SetPrefilter(const std::string& text, CorrelationImageOptions& options);

// The options of subsets and their correlation, the same wherever images are correlated.
class FieldOptionSet {
 public:
  // The subset where none is given.
  explicit FieldOptionSet(int subset_px = CorrelatorOptions().subset_px) {
    correlator_.subset_px = subset_px;
  }

  // noise_file: whether --noise is one of them.
  void Declare(OptionTable& options, bool noise_file = true);

  // With the grid's step left to the caller. Throws UsageError.
  FieldOptions Options(std::uint64_t seed) const;

  bool order_given() const { return order_.has_value(); }
  const std::string& noise() const { return noise_; }  // the noise file; empty: none

 private:
  CorrelatorOptions correlator_;
  std::optional<int> order_;
  std::string shape_ = "square", interpolation_ = "quintic", prefilter_ = "low-pass", noise_;
  bool no_verify_ = false, keep_still_parts_ = false;
};

}  // namespace plumbline::internal
