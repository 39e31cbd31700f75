#include "io/internal/reference_group.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "calib/status.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_images.h"
#include "io/internal/series_layout.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;

constexpr const char* kGroup = "/reference";

// The numbers of a point, matrices row by row.
void Put(float value, float* to) { *to = value; }
template <int N>
void Put(const Eigen::Matrix<float, N, 1>& value, float* to) {
  std::copy_n(value.data(), N, to);
}
void Put(const Eigen::Matrix2f& value, float* to) {
  const Eigen::Matrix2f rows = value.transpose();
  std::copy_n(rows.data(), 4, to);
}
void Put(Status, float*) { throw std::logic_error("the status is no part of a match"); }

template <typename Element>
std::vector<float> NumbersOf(const Image<Element>& image, const Image<Status>& status,
                             std::size_t count) {
  if (image.size() != status.size()) {
    throw std::invalid_argument("the matches of the reference differ in size from its status");
  }
  std::vector<float> numbers(status.pixel_count() * count, std::numeric_limits<float>::quiet_NaN());
  for (std::size_t i = 0; i < status.pixel_count(); ++i) {
    if (status.data()[i] == Status::kOk) Put(image.data()[i], &numbers[i * count]);
  }
  return numbers;
}

std::string NameAxisOf(hid_t file, const ComponentAxis& axis) {
  const std::string path = std::string(kGroup) + "/" + std::string(axis.name);
  if (!hdf5::Exists(file, path)) {
    WriteNameAxis(file, path, std::string(axis.name), "component of the value",
                  {axis.labels.begin(), axis.labels.end()});
  }
  return path;
}

}  // namespace

std::string PathInReference(const PointField& field) {
  const std::string path = field.Path();
  return kGroup + path.substr(path.rfind('/'));
}

void WriteReferenceGroup(hid_t file, const ReferenceMatches& reference, ImageSize grid) {
  if (reference.status.size() != grid) {
    throw std::invalid_argument("the matches of the reference are not of the grid's size");
  }
  const Id group = hdf5::CreateGroup(file, kGroup);
  hdf5::SetText(group.get(), "left_id", reference.left_id);
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "left_displacement");
  hdf5::SetTexts(group.get(), "axes", {"row", "col", "component"});
  std::vector<std::string> scales = {std::string(kGroup) + "/row", std::string(kGroup) + "/col"};
  hdf5::HardLink(file, "/grid/row", scales[0]);
  hdf5::HardLink(file, "/grid/col", scales[1]);
  const hdf5::Shape shape = {static_cast<hsize_t>(grid.height), static_cast<hsize_t>(grid.width)};
  const hsize_t band = std::max<hsize_t>(1, std::min(shape[0], (hsize_t{1} << 16) / shape[1]));
  SeriesFrame frame;
  frame.match = reference.match;
  for (const PointField& field : StereoPoints().fields) {
    if (field.group != kMatch) continue;
    hdf5::DatasetSpec spec{PathInReference(field),
                           std::string(field.units),
                           std::string(field.long_name),
                           shape,
                           {band, shape[1]}};
    std::vector<std::string> axes = scales;
    const std::size_t count = field.axis->count();
    if (count > 1) {
      spec.shape.push_back(count);
      spec.chunk.push_back(count);
      axes.push_back(NameAxisOf(file, *field.axis));
    }
    VisitImage(frame, field, [&](const auto& image) {
      const std::vector<float> numbers = NumbersOf(image, reference.status, count);
      hdf5::AttachScales(file, hdf5::WriteArray<float>(file, spec, numbers), axes);
    });
  }
  const Id status = CreateEnumDataset(
      file, {kReferenceStatus, "1", "why there is no match here, or ok", shape, {}}, kStatusNames,
      static_cast<std::uint8_t>(Status::kMasked));
  const Id type = hdf5::EnumType(kStatusNames);
  hdf5::Check(
      H5Dwrite(status.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, reference.status.data()),
      "writing the status of the reference");
  hdf5::AttachScales(file, status, scales);
}

}  // namespace plumbline::internal
