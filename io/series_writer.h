#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "io/rig_file.h"
#include "io/series_frame.h"
#include "io/series_shard.h"
#include "io/series_start.h"
#include "track/right_delay.h"

namespace plumbline {

// A signal that was recorded beside the cameras, as /channels/<name> holds it, on its own time
// axis. value may hold NaN (a dropout).
struct Channel {
  std::string name, units, long_name;
  std::vector<double> time_s;  // on a clock of its own; never going back
  std::vector<double> value;
  // What that clock reads when SeriesFrame::time_s is 0, and its sigma; NaN: not known.
  double clock_offset_s = std::numeric_limits<double>::quiet_NaN();
  double sigma_clock_offset_s = std::numeric_limits<double>::quiet_NaN();
};

struct SeriesHeader {
  StereoRig rig;
  Image<Eigen::Vector2f> grid_px;  // (row, col): where the points sit in the left image
  int step_px = 1;
  int subset_px = 0;        // the matcher's window
  std::string recipe_toml;  // full, defaults filled in
  std::vector<std::filesystem::path> inputs;
  RigFileExtras rig_extras;  // what else /rig is to hold
  SeriesContents contents = {};
  // What the points are, attribute `points` of /grid: "image" (the grid is fixed in the left image
  // in every frame) or "material" (the material points that were at the grid's pixels in the first
  // frame).
  std::string grid_points = "image";
  // What displacements count from, attribute `reference` of /displacement: "frame N" (SeriesFrame::
  // index), "previous" or "wheel".
  std::string displacement_reference = "frame 0";
  std::optional<ReferenceMatches> reference = {};
  // Attribute of /displacement: the rigid motion of the whole surface (/rigid_motion) is taken out.
  bool rigid_motion_removed = false;
  // Attributes of /strain: the measure (a name of track/strain_measure.h), what the local x axis of
  // its components follows ("material": the columns of the grid; "ground": the direction of travel;
  // or a direction "x,y,z" in the frame of the positions), and the size of the virtual strain
  // gauge, in the left image and on the surface.
  std::string strain_measure = "green_lagrange";
  std::string strain_axes = "material";
  int vsg_px = 0;
  double vsg_mm = 0;
  std::string slip_convention = "ISO 8855";  // attribute of /slip
  // Attributes of /wheel: the delay of the right camera that is taken out of a rolling tyre, and
  // what its images say of it, where they do.
  std::optional<RightDelay> right_delay = {}, estimated_right_delay = {};
  // Attribute of /survey: frames of the recording that the survey went over.
  std::int64_t surveyed_frames = 0;
  std::vector<Channel> channels = {};
  std::optional<SeriesShard> shard = {};  // nothing: the run is whole
};

// Writes one run.
//
// While it goes on, everything lies in the folder `<file>.parts`: header.h5, and a journal in which
// each frame is written, checksummed and forced to the disk before Commit() returns. Close() packs
// both into `file` (temporary name, fsync, rename) and removes the folder. A run that is killed, or
// meets a full disk, loses no committed frame: RecoverSeries() packs what is there, or a writer
// with SeriesStart::kResume goes on. Memory is that of one frame, whatever the length of the run.
//
// Numbers of points whose status is not kOk are written as NaN, and so is all that is infinite; a
// point that claims kOk without a finite position, or a strain that does without a finite value, is
// written as failed_verification. A displacement, velocity or match that is not finite is written
// as NaN with all that goes by it. What the contents do not name is not written.
//
// Not thread-safe (one writer, one thread); packs a frame with all of TBB's threads.
class SeriesWriter {
 public:
  // Throws EnvironmentError naming the folder or file (not writable, disk full), InputError when
  // the start is refused (see SeriesStart) or a channel cannot be stored (its name, its size,
  // times that go back), std::invalid_argument when the grid is empty or an attribute is none of
  // those named in SeriesHeader.
  SeriesWriter(const std::filesystem::path& file, const SeriesHeader& header,
               SeriesStart start = SeriesStart::kNew, const LiveReading& live = {});

  // Without Close(): keeps the parts for RecoverSeries() if a frame was committed.
  ~SeriesWriter();
  SeriesWriter(const SeriesWriter&) = delete;
  SeriesWriter& operator=(const SeriesWriter&) = delete;

  // Throws EnvironmentError (disk full; earlier frames stay), std::invalid_argument when the
  // surface, or another field of points that is not empty, is not of the grid's size.
  void Commit(const SeriesFrame& frame);

  // Frames that are on the disk, those of before a resume too, and the index of the last of them;
  // nothing: there is none.
  std::int64_t committed() const;
  std::optional<std::int64_t> last_index() const;

  // Why there is no live.h5 any more (a full disk...), though the run goes on; empty: there is one.
  std::string live_problem() const;

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
