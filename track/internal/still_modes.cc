#include "track/internal/still_modes.h"

#include <fmt/format.h>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

void AppendZeroRows(int count, Eigen::MatrixXd* modes) {
  const Eigen::Index rows = modes->rows();
  modes->conservativeResize(rows + count, Eigen::NoChange);
  modes->bottomRows(count).setZero();
}

}  // namespace

void AppendStillModes(int count, const char* what, WheelReference* wheel) {
  if (wheel->rig.modes.count() == 0) {
    throw UsageError(fmt::format(
        "A sigma of {} counts with the errors of the calibration, and the wheel's rig has none: "
        "calibrate it with plumbline calibrate, or leave the sigma out.",
        what));
  }
  AppendZeroRows(count, &wheel->rig.modes.modes);
  AppendZeroRows(count, &wheel->axis_along_modes);
  AppendZeroRows(count, &wheel->angles_along_modes_rad);
  for (WheelTag& tag : wheel->tags.tags) AppendZeroRows(count, &tag.along_modes_mm);
}

}  // namespace plumbline::internal
