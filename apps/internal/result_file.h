#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "calib/stereo_rig.h"
#include "io/planar_series_reader.h"
#include "io/series_reader.h"

namespace plumbline::internal {

// A file that `info` and `validate` are asked about, opened as what it is.
struct ResultFile {
  std::unique_ptr<SeriesReader> series;        // a run of a rig
  std::unique_ptr<PlanarSeriesReader> planar;  // a run of one camera
  std::optional<StereoRig> rig;                // of a run of a rig too
};

// Throws InputError when it is neither a run nor a rig file, saying what to do where that is known
// (a run that was killed: recover).
ResultFile OpenResultFile(const std::string& path);

// The rig in a few lines.
std::string RigText(const StereoRig& rig);

// Refuses an output that is there already (unless it may be replaced), that is one of the inputs,
// or whose folder is not. Throws InputError, EnvironmentError.
std::filesystem::path CheckedOutput(const std::string& output, bool overwrite);

// "surface.ply" and frame 7 of several: "surface_0007.ply".
std::filesystem::path NumberedFile(const std::filesystem::path& file, std::int64_t index);

}  // namespace plumbline::internal
