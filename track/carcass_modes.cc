#include "track/carcass_modes.h"

#include "calib/error.h"

namespace plumbline {
namespace {

void AppendZeroRows(int count, Eigen::MatrixXd* modes) {
  const Eigen::Index rows = modes->rows();
  modes->conservativeResize(rows + count, Eigen::NoChange);
  modes->bottomRows(count).setZero();
}

}  // namespace

WheelReference WithCarcassModes(WheelReference wheel, const CarcassThickness& carcass) {
  carcass.Check();
  const int count = carcass.mode_count();
  if (count == 0) return wheel;
  if (wheel.rig.modes.count() == 0) {
    throw UsageError(
        "A sigma of the carcass counts with the errors of the calibration, and the wheel's rig has "
        "none: calibrate it with plumbline calibrate, or leave the sigma out.");
  }
  AppendZeroRows(count, &wheel.rig.modes.modes);
  AppendZeroRows(count, &wheel.axis_along_modes);
  AppendZeroRows(count, &wheel.angles_along_modes_rad);
  return wheel;
}

}  // namespace plumbline
