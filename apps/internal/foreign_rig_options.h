#pragma once

#include <string>

#include "apps/internal/option_table.h"
#include "apps/rig_input.h"

namespace plumbline::internal {

// What rig files of other programs do not say of themselves, wherever a rig is taken.
class ForeignRigOptionSet {
 public:
  void Declare(OptionTable& options);
  ForeignCalibrationOptions Options() const;  // throws UsageError

 private:
  double length_unit_mm_ = 1;
  std::string image_size_;
};

}  // namespace plumbline::internal
