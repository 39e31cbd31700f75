#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "io/planar_series.h"
#include "io/series_start.h"

namespace plumbline {

// Writes one run of 2D-DIC, with the promises and the parts folder of SeriesWriter: a frame is on
// the disk before Commit() returns, RecoverSeries() packs what a killed run left, memory is that
// of one frame.
//
// Numbers of points whose status is not kOk are written as NaN (but for the correlation, which may
// tell something where it failed, and the iterations), and so is all that is infinite; a point that
// claims kOk without a finite displacement or strain is written as failed_verification. What the
// contents do not name is not written.
//
// Not thread-safe (one writer, one thread); packs a frame with all of TBB's threads.
class PlanarSeriesWriter {
 public:
  // Throws EnvironmentError naming the folder or file (not writable, disk full), InputError when
  // the start is refused (see SeriesStart), std::invalid_argument naming what in the header is none
  // of the values named there.
  PlanarSeriesWriter(const std::filesystem::path& file, const PlanarSeriesHeader& header,
                     SeriesStart start = SeriesStart::kNew, const LiveReading& live = {});

  // Without Close(): keeps the parts for RecoverSeries() if a frame was committed.
  ~PlanarSeriesWriter();
  PlanarSeriesWriter(const PlanarSeriesWriter&) = delete;
  PlanarSeriesWriter& operator=(const PlanarSeriesWriter&) = delete;

  // Throws EnvironmentError (disk full; earlier frames stay), std::invalid_argument when the field
  // is of another grid, step, subset or order than the header, or an image of it or of the strain
  // is not of the grid's size.
  void Commit(const PlanarSeriesFrame& frame);

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

}  // namespace plumbline
