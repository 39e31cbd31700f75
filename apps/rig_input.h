#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/camera_file.h"
#include "calib/stereo_rig.h"

namespace plumbline {

struct RigInput {
  StereoRig rig;
  std::optional<double> working_distance_mm;  // of the board while it was calibrated
  std::vector<std::string> files;
  std::vector<std::string> notes;  // a sentence each: what was assumed, what is not known
};

// The rig that --rig names: a rig file or a series (.h5), `left.cameramodel,right.cameramodel`, or
// the stereo calibration of another program (OpenCV, DICe, VIC-3D, MatchID). Throws InputError
// naming the file and what is wrong with it.
RigInput OpenRig(const std::string& text, const ForeignCalibrationOptions& options = {});

}  // namespace plumbline
