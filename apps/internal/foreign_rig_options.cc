#include "apps/internal/foreign_rig_options.h"

#include "apps/internal/measure_report.h"

namespace plumbline::internal {

void ForeignRigOptionSet::Declare(OptionTable& options) {
  options.Add({.name = "rig-length-unit",
               .help = "how many mm the rig file's unit of length is, for OpenCV files in metres: "
                       "1000",
               .unit = "mm",
               .min = 1e-6},
              &length_unit_mm_);
  options.Add({.name = "rig-image-size",
               .help = "image size, for rig files of other programs that do not hold it",
               .unit = "WxH px"},
              &image_size_);
}

ForeignCalibrationOptions ForeignRigOptionSet::Options() const {
  ForeignCalibrationOptions foreign;
  foreign.length_unit_mm = length_unit_mm_;
  if (!image_size_.empty()) foreign.image_size = ParseImageSize(image_size_);
  return foreign;
}

}  // namespace plumbline::internal
