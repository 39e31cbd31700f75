#pragma once

#include <memory>
#include <string>

#include "apps/internal/foreign_rig_options.h"
#include "apps/internal/frame_options.h"
#include "apps/internal/option_table.h"
#include "apps/rig_input.h"
#include "io/image_source.h"

namespace plumbline::internal {

// A recording of both cameras of a calibrated rig.
class RecordingOptionSet {
 public:
  // In the order of the help: the rig and the images first, which of these and when they were taken
  // further down, what rig files of other programs do not say last.
  // rig_required: false where the rig may come from elsewhere.
  void Declare(OptionTable& options, bool rig_required = true);
  void DeclareFrames(OptionTable& options);
  void DeclareForeign(OptionTable& options);

  bool has_rig() const { return !rig_.empty(); }
  RigInput Rig() const;  // its notes are told
  std::unique_ptr<ImageSource> Open() const;
  // The same recording, other frames of it.
  std::unique_ptr<ImageSource> Open(const ImageSourceOptions& options) const;

  const FrameOptionSet& frames() const { return frames_; }

 private:
  std::string rig_, left_, right_;
  FrameOptionSet frames_;
  ForeignRigOptionSet foreign_rig_;
};

}  // namespace plumbline::internal
