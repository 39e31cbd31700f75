#pragma once

#include <cstdint>
#include <vector>

#include "io/internal/hdf5.h"
#include "io/series_frame.h"

namespace plumbline::internal {

// The contours of /patch: the points of all frames one after the other in `contour` (n, 2), with
// the frame of each in its axis `contour_frame`; of each frame the first one and how many they are
// in `contour_first` and `contour_count`. Unlike HDF5's variable-length type, every reader knows
// these, they are compressed, and carry axes and units.
class PatchContours {
 public:
  // Creates the datasets. Throws hdf5::Error, as all here.
  explicit PatchContours(hid_t file);

  // Adds the contour of the next frame, and takes it away from the frame: it may be long. A frame
  // without a patch has none.
  void Take(SeriesFrame* frame);

  // Once /frames and the rest of /patch are there.
  void Finish();

 private:
  hid_t file_;
  hdf5::Id contour_, frame_;
  std::vector<std::int64_t> first_, count_;
};

// That of frame i. Throws hdf5::Error.
std::vector<Eigen::Vector2d> ReadPatchContour(hid_t file, hsize_t i);

}  // namespace plumbline::internal
