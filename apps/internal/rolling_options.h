#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "apps/rolling_run.h"

namespace plumbline::internal {

// What `measure` of a rolling tyre has beside stereo-DIC's own options.
class RollingOptionSet {
 public:
  void Declare(OptionTable& options);

  bool given() const { return !file_.empty(); }
  const std::string& file() const { return file_; }

  // The wheel that the tyre is measured against. Throws InputError naming the file and what is
  // wrong with it.
  WheelReference Wheel() const;

  // dic: as for any other recording; order_given: by the user. Of order 1 subsets of 33 px are off
  // by five times their sigma where the tyre is bent (docs/user_guide.md), so that 2 is the
  // default.
  RollingRunOptions Options(const StereoRunOptions& dic, bool order_given) const;

 private:
  std::string file_;
  std::optional<double> jerk_rad_s25_;
};

}  // namespace plumbline::internal
