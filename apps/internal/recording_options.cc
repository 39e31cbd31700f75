#include "apps/internal/recording_options.h"

#include <spdlog/spdlog.h>

namespace plumbline::internal {

void RecordingOptionSet::Declare(OptionTable& options, bool rig_required) {
  options.Add(
      {.name = "rig",
       .help = "the calibrated rig: rig.h5, left.cameramodel,right.cameramodel, or a stereo "
               "calibration of OpenCV, DICe, VIC-3D or MatchID",
       .unit = "FILE",
       .required = rig_required},
      &rig_);
  options.Add(
      {.name = "left",
       .help = "images of the left camera: a pattern in quotes, a folder, an image or a video",
       .unit = "FILES",
       .required = true},
      &left_);
  options.Add(
      {.name = "right", .help = "those of the right camera", .unit = "FILES", .required = true},
      &right_);
}

void RecordingOptionSet::DeclareFrames(OptionTable& options) {
  frames_.Declare(options, "pairs", "frame");
}

void RecordingOptionSet::DeclareForeign(OptionTable& options) { foreign_rig_.Declare(options); }

RigInput RecordingOptionSet::Rig() const {
  RigInput rig = OpenRig(rig_, foreign_rig_.Options());
  for (const std::string& note : rig.notes) spdlog::info("Note: {}", note);
  return rig;
}

std::unique_ptr<ImageSource> RecordingOptionSet::Open() const { return Open(frames_.Options()); }

std::unique_ptr<ImageSource> RecordingOptionSet::Open(const ImageSourceOptions& options) const {
  return OpenImageSource(left_, right_, options);
}

}  // namespace plumbline::internal
