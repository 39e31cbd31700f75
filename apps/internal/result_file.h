#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "calib/stereo_rig.h"
#include "io/series_reader.h"

namespace plumbline::internal {

// A file that `info` and `validate` are asked about, opened as what it is.
struct ResultFile {
  std::unique_ptr<SeriesReader> series;  // a run
  std::optional<StereoRig> rig;          // of a run too
};

// Throws InputError when it is neither a run nor a rig file, saying what to do where that is known
// (a run that was killed: recover).
ResultFile OpenResultFile(const std::string& path);

// The rig in a few lines.
std::string RigText(const StereoRig& rig);

}  // namespace plumbline::internal
