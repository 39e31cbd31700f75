#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "io/rig_file.h"
#include "io/series_frame.h"

namespace plumbline {

struct SeriesHeader {
  StereoRig rig;
  Image<Eigen::Vector2f> grid_px;  // (row, col): where the points sit in the left image
  int step_px = 1;
  int subset_px = 0;        // the matcher's window
  std::string recipe_toml;  // full, defaults filled in
  std::vector<std::filesystem::path> inputs;
  RigFileExtras rig_extras;  // what else /rig is to hold
  bool has_covariance = false;
};

// Writes one run.
//
// While it goes on, everything lies in the folder `<file>.parts`: header.h5, and a journal in which
// each frame is written, checksummed and forced to the disk before Commit() returns. Close() packs
// both into `file` (temporary name, fsync, rename) and removes the folder. A run that is killed, or
// meets a full disk, loses no committed frame: RecoverSeries() packs what is there. Memory is that
// of one frame, whatever the length of the run.
//
// Positions, sigmas and covariances of points whose status is not kOk are written as NaN; a point
// that claims kOk without a finite position is written as failed_verification.
//
// Not thread-safe (one writer, one thread); packs a frame with all of TBB's threads.
class SeriesWriter {
 public:
  // Throws EnvironmentError naming the folder or file (not writable, disk full), InputError when
  // an unfinished run of the same name is there, std::invalid_argument when the grid is empty.
  SeriesWriter(const std::filesystem::path& file, const SeriesHeader& header);

  // Without Close(): keeps the parts for RecoverSeries() if a frame was committed.
  ~SeriesWriter();
  SeriesWriter(const SeriesWriter&) = delete;
  SeriesWriter& operator=(const SeriesWriter&) = delete;

  // Throws EnvironmentError (disk full; earlier frames stay), std::invalid_argument when the
  // surface is not of the grid's size.
  void Commit(const SeriesFrame& frame);

  std::int64_t committed() const;

  // Throws EnvironmentError; the parts then stay.
  void Close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct RecoveredSeries {
  std::int64_t frames = 0;
  // Bytes after the last whole frame: of one that was being written when the run ended.
  std::int64_t bytes_dropped = 0;
};

// Packs what a killed run left in `<file>.parts` into `file`. Throws InputError when there is
// nothing to recover or the run is still going on, EnvironmentError as Close().
RecoveredSeries RecoverSeries(const std::filesystem::path& file);

}  // namespace plumbline
