#include "apps/internal/rolling_options.h"

#include <fmt/format.h>

#include "calib/error.h"
#include "io/wheel_file.h"

namespace plumbline::internal {

void RollingOptionSet::Declare(OptionTable& options, const std::string& help) {
  options.Add({.name = "reference", .help = help, .unit = "FILE"}, &file_);
  options.Add({.name = "wheel-jerk",
               .help = "how fast the wheel's acceleration may change, as the density of white "
                       "noise, for the smoothing of its angle; auto: from the recording",
               .unit = "rad/s^2.5",
               .min = 0,
               .max = 1e9},
              &jerk_rad_s25_);
}

WheelReference RollingOptionSet::WheelOf(const std::string& file) {
  WheelReference wheel = ReadWheelFile(file);
  if (wheel.views.empty()) {
    throw InputError(fmt::format(
        "'{}' holds no reference images: make it again with plumbline reference.", file));
  }
  return wheel;
}

RollingRunOptions RollingOptionSet::Options(const StereoRunOptions& dic, bool order_given) const {
  RollingRunOptions options;
  options.sequence = dic.sequence;
  if (!order_given) options.sequence.field.correlator.order = 2;
  options.survey.matching = options.sequence;
  options.survey.matching.strategy = StereoStrategy::kReference;
  options.survey.smoother.jerk_rad_s25 = jerk_rad_s25_;
  options.survey.refinement = dic.evaluation.refinement;
  options.evaluation = dic.evaluation;
  options.roi = dic.roi;
  options.mask = dic.mask;
  options.Check();
  return options;
}

}  // namespace plumbline::internal
