#pragma once

#include <memory>
#include <string>
#include <vector>

#include "io/series_writer.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {

// The truth of a recording in the schema of a measurement (docs/file_format.md), so that what reads
// one reads the other: positions, displacements and strains at the points of a grid, ground, wheel,
// patch, slip. All sigmas are zero.
//
// A point has a value where a perfect measurement would: its material is seen by both cameras. Else
// its status is outside_image, occluded, or masked where the left camera sees no specimen.
// The patch is true contact (threshold 0); d_area_d_threshold is the mean over the first 0.5 mm.
class TruthSeries {
 public:
  // `rig` must outlive it.
  explicit TruthSeries(const VirtualRig& rig);

  // recipe_toml and inputs are the caller's to fill in.
  SeriesHeader Header(const std::vector<Channel>& channels = {}) const;
  // The truth of one exposure. Index and time are those of the recording, which begins with its
  // first frame that is not dropped; `dropped_before` counts those that are. The images' names are
  // the caller's to fill in.
  SeriesFrame Frame(int frame) const;

 private:
  Image<Eigen::Vector2f> GridPixels() const;
  void FillPoints(const TrueFrame& truth, SeriesFrame* frame) const;
  void FillGround(const TrueFrame& truth, SeriesFrame* frame) const;
  void FillTyre(double time_s, SeriesFrame* frame) const;

  const VirtualRig& rig_;
  std::vector<int> recorded_;
  Image<Eigen::Vector2f> grid_px_;
  // Where the grid follows the material: what was under its points in the first frame (NaN: none).
  Image<Eigen::Vector2d> material_;
};

}  // namespace plumbline
