#pragma once

#include "calib/calibrate.h"
#include "io/rig_file.h"

namespace plumbline::internal {

// What a calibration leaves in the rig file beside the rig: the covariance, the target as it was
// found, residuals, pairs, figures of merit.
RigFileExtras CalibrationExtras(const Calibration& calibration);

}  // namespace plumbline::internal
