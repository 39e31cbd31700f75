#include "io/internal/point_groups.h"

#include <algorithm>
#include <limits>

#include "calib/status.h"
#include "io/internal/series_datasets.h"

namespace plumbline::internal {

using hdf5::Id;

PointGroups::PointGroups(hid_t file, const PointLayout& layout, const SeriesShape& shape)
    : file_(file), layout_(layout), shape_(shape) {
  for (const PointGroupFacts& group : layout.groups) {
    if (!Holds(shape.content_bits, group.needs)) continue;
    const Id id = hdf5::CreateGroup(file, std::string(group.path));
    hdf5::SetText(id.get(), "NX_class", "NXdata");
    hdf5::SetText(id.get(), "signal", std::string(group.signal));
    hdf5::SetTexts(id.get(), "axes", {"frame", "row", "col", "component"});
  }
  for (const PointField& field : layout.fields) {
    datasets_.push_back(Holds(shape.content_bits, field.needs) ? Create(field) : Id());
  }
}

void PointGroups::Add(const std::vector<PointChunk>& chunks) {
  for (std::size_t i = 0; i < datasets_.size(); ++i) {
    if (datasets_[i].get() < 0) continue;
    hdf5::Shape extent = Extent(layout_.fields[i], frames_ + 1);
    hdf5::Check(H5Dset_extent(datasets_[i].get(), extent.data()), "adding a frame");
  }
  for (const PointChunk& chunk : chunks) {
    hdf5::Shape offset = Extent(layout_.fields[chunk.field], frames_);
    std::fill(offset.begin() + 1, offset.end(), 0);
    offset[1] = static_cast<hsize_t>(chunk.band) * static_cast<hsize_t>(shape_.band_rows);
    hdf5::Check(H5Dwrite_chunk(datasets_[chunk.field].get(), H5P_DEFAULT, 0, offset.data(),
                               chunk.bytes.size(), chunk.bytes.data()),
                "writing a frame");
  }
  ++frames_;
}

void PointGroups::Finish() {
  for (const PointGroupFacts& group : layout_.groups) {
    if (!Holds(shape_.content_bits, group.needs)) continue;
    const std::string path(group.path);
    hdf5::HardLink(file_, "/frames/index", path + "/frame");
    hdf5::HardLink(file_, "/grid/row", path + "/row");
    hdf5::HardLink(file_, "/grid/col", path + "/col");
  }
  for (std::size_t i = 0; i < datasets_.size(); ++i) {
    if (datasets_[i].get() >= 0) Attach(layout_.fields[i], &datasets_[i]);
  }
}

hdf5::Shape PointGroups::Extent(const PointField& field, hsize_t frames) const {
  hdf5::Shape extent = {frames, static_cast<hsize_t>(shape_.rows),
                        static_cast<hsize_t>(shape_.columns)};
  if (field.axis->count() > 1) extent.push_back(field.axis->count());
  return extent;
}

Id PointGroups::Create(const PointField& field) const {
  hdf5::DatasetSpec spec{field.Path(), std::string(field.units), std::string(field.long_name),
                         Extent(field, 0), Extent(field, 1)};
  spec.chunk[1] = static_cast<hsize_t>(shape_.band_rows);
  switch (field.type) {
    case PointType::kStatus:  // in a frame without values every point is masked
      return CreateEnumDataset(file_, spec, kStatusNames,
                               static_cast<std::uint8_t>(Status::kMasked));
    case PointType::kByte:
      return hdf5::CreateDataset(file_, spec, H5T_NATIVE_UINT8);
    case PointType::kDouble: {
      const double fill = std::numeric_limits<double>::quiet_NaN();
      return hdf5::CreateDataset(file_, spec, H5T_NATIVE_DOUBLE, &fill);
    }
    default: {
      const float fill = std::numeric_limits<float>::quiet_NaN();
      return hdf5::CreateDataset(file_, spec, H5T_NATIVE_FLOAT, &fill);
    }
  }
}

void PointGroups::Attach(const PointField& field, Id* dataset) {
  std::vector<std::string> scales = {"/frames/index", "/grid/row", "/grid/col"};
  const ComponentAxis& axis = *field.axis;
  if (axis.count() > 1) {
    const std::string label(axis.name);
    scales.push_back(std::string(layout_.groups[field.group].path) + "/" + label);
    if (!hdf5::Exists(file_, scales.back())) {
      WriteNameAxis(file_, scales.back(), label, "component of the value",
                    {axis.labels.begin(), axis.labels.end()});
    }
  }
  hdf5::AttachScales(file_, *dataset, scales);
  if (!field.also.empty()) hdf5::HardLink(file_, field.Path(), std::string(field.also));
  dataset->Close("closing a dataset");
}

}  // namespace plumbline::internal
