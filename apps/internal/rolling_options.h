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
  // help: of --reference.
  void Declare(OptionTable& options, const std::string& help = kReferenceHelp);

  bool given() const { return !file_.empty(); }
  const std::string& file() const { return file_; }

  // The wheel that the tyre is measured against. Throws InputError naming the file and what is
  // wrong with it.
  WheelReference Wheel() const { return WheelOf(file_); }
  static WheelReference WheelOf(const std::string& file);

  // dic: as for any other recording; order_given: by the user. Of order 1 subsets of 33 px are off
  // by five times their sigma where the tyre is bent (docs/user_guide.md), so that 2 is the
  // default.
  RollingRunOptions Options(const StereoRunOptions& dic, bool order_given) const;

 private:
  static constexpr const char* kReferenceHelp =
      "the undeformed wheel (plumbline reference): a loaded, rolling tyre is measured against it, "
      "with its wheel angle; the rig is that of the file";

  std::string file_;
  std::optional<double> jerk_rad_s25_;
};

}  // namespace plumbline::internal
