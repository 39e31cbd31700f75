#pragma once

#include <string>
#include <vector>

#include "io/internal/hdf5.h"
#include "io/internal/point_layout.h"

namespace plumbline::internal {

// The groups of fields of points of a series being packed, growing by one frame at a time. Throws
// hdf5::Error.
class PointGroups {
 public:
  PointGroups(hid_t file, const PointLayout& layout, const SeriesShape& shape);

  // The next frame; without chunks, all of it is fill values.
  void Add(const std::vector<PointChunk>& chunks);

  // Once /frames and /grid are there: the axes.
  void Finish();

 private:
  hdf5::Shape Extent(const PointField& field, hsize_t frames) const;
  hdf5::Id Create(const PointField& field) const;
  void Attach(const PointField& field, hdf5::Id* dataset);

  hid_t file_;
  const PointLayout& layout_;
  SeriesShape shape_;
  std::vector<hdf5::Id> datasets_;  // by the place in PointLayout::fields; closed: not held
  hsize_t frames_ = 0;
};

}  // namespace plumbline::internal
