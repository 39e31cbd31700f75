#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "io/planar_series.h"
#include "io/series_frame.h"

namespace plumbline {

// Reads a run of 2D-DIC, also one that is not ours: nothing in the file can make it read another
// file, and sizes are checked before memory is taken.
//
// Not thread-safe.
class PlanarSeriesReader {
 public:
  // Throws InputError naming the file and what is missing or wrong in it.
  explicit PlanarSeriesReader(const std::filesystem::path& file);
  ~PlanarSeriesReader();

  const SeriesFacts& facts() const;

  // As it was written, but for `inputs`, which facts() tells; what is said of a strain that is not
  // there are the defaults. With another strain (and another recipe) it heads a series of the same
  // frames: nothing has to be correlated again for that.
  const PlanarSeriesHeader& header() const;
  std::int64_t frame_count() const;

  // Frame i of the file, 0 <= i < frame_count(). The field is empty where the frame has a problem;
  // else it is what was written, bit for bit where the status is ok (NaN elsewhere). Without the
  // contents' gradient_covariance, cov_gradient holds the squared sigmas on its diagonal and NaN
  // beside it. The strain is all masked where the frame had none, and empty where the series has
  // none. Memory: that of one frame. Throws InputError, std::out_of_range.
  PlanarSeriesFrame Frame(std::int64_t i) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Whether the file is a series of one camera. Throws InputError where it cannot be read.
bool IsPlanarSeries(const std::filesystem::path& file);

}  // namespace plumbline
