#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "io/planar_series.h"
#include "io/series_frame.h"

namespace plumbline {

// What is in a series or a rig file, for `plumbline info`.
struct FileSummary {
  std::string format;   // "plumbline-series" or "plumbline-rig"
  bool planar = false;  // a series of one camera, which has no rig
  std::string lens_model;
  double baseline_mm = 0;
  int calibration_modes = 0;
  // Series only.
  std::string created, software;
  bool goes_on = false;  // as SeriesFacts
  std::int64_t frames = 0;
  std::int64_t frames_with_surface = 0;  // of a planar series: with a displacement field
  std::int64_t frames_with_ground = 0;
  int grid_rows = 0;
  int grid_columns = 0;
  std::int64_t points = 0;  // with status ok, over all frames
  SeriesContents contents;
  PlanarContents planar_contents;
  std::int64_t strain_points = 0;     // of a planar series, as `points`
  std::vector<std::string> channels;  // their names

  std::string Text() const;  // one fact a line
};

// Throws InputError where the file can be read neither as a series nor as a rig file.
FileSummary Inspect(const std::filesystem::path& file);

// What is wrong with a file by docs/file_format.md, one sentence each; empty: it is whole. Looks
// for groups, datasets and attributes that are missing, shapes that disagree, datasets without
// units, long_name or axes, the folder of an unfinished run; of a series it reads every frame: each
// value must be a number where its status is ok (a displacement, strain or velocity of a surface
// may be NaN), and NaN elsewhere. A file that cannot be opened is one finding. Memory: that of one
// frame.
std::vector<std::string> Validate(const std::filesystem::path& file);

}  // namespace plumbline
