#include "io/internal/patch_contours.h"

#include <utility>

namespace plumbline::internal {
namespace {

constexpr hsize_t kChunkPoints = 4096;
constexpr hsize_t kMaxContourValues = hsize_t{1} << 24;

}  // namespace

PatchContours::PatchContours(hid_t file) : file_(file) {
  contour_ = hdf5::CreateDataset(
      file,
      {"/patch/contour",
       "mm",
       "points of the closed contours of all frames, one after the other, in the ground frame",
       {0, 2},
       {kChunkPoints, 2}},
      H5T_NATIVE_DOUBLE);
  frame_ = hdf5::CreateDataset(
      file,
      {"/patch/contour_frame", "1", "frame of the point, as /frames/index", {0}, {kChunkPoints}},
      H5T_NATIVE_INT64);
}

void PatchContours::Take(SeriesFrame* frame) {
  const std::vector<Eigen::Vector2d> points = std::exchange(frame->patch.contour_mm, {});
  const std::size_t count = frame->patch.found ? points.size() : 0;
  first_.push_back(first_.empty() ? 0 : first_.back() + count_.back());
  count_.push_back(static_cast<std::int64_t>(count));
  if (count == 0) return;
  hdf5::AppendRows<double>(contour_, {points[0].data(), 2 * count});
  hdf5::AppendRows<std::int64_t>(frame_, std::vector<std::int64_t>(count, frame->index));
}

void PatchContours::Finish() {
  hdf5::MakeScale(frame_, "contour_frame");
  hdf5::AttachScales(file_, contour_, {"/patch/contour_frame", "/patch/component"});
  const auto column = [&](const char* path, const char* long_name,
                          const std::vector<std::int64_t>& values) {
    hdf5::AttachScales(
        file_,
        hdf5::WriteArray<std::int64_t>(file_, {path, "1", long_name, {values.size()}, {}}, values),
        {"/frames/index"});
  };
  column("/patch/contour_first", "place in `contour` of the frame's first point", first_);
  column("/patch/contour_count", "how many points of `contour` are the frame's", count_);
  contour_.Close("closing a dataset");
  frame_.Close("closing a dataset");
}

std::vector<Eigen::Vector2d> ReadPatchContour(hid_t file, hsize_t i) {
  const auto place = [&](const char* path) {
    const double value = hdf5::ReadSlab<double>(hdf5::OpenDataset(file, path), i, 1).at(0);
    if (!(value >= 0 && value <= 1e15)) throw hdf5::Error(std::string(path) + " is out of range");
    return static_cast<hsize_t>(value);
  };
  const hdf5::Id dataset = hdf5::OpenDataset(file, "/patch/contour");
  const hdf5::Shape shape = hdf5::ShapeOf(dataset);
  if (shape.size() != 2 || shape[1] != 2) throw hdf5::Error("/patch/contour is not (points, 2)");
  const auto values = hdf5::ReadRows<double>(dataset, place("/patch/contour_first"),
                                             place("/patch/contour_count"), kMaxContourValues);
  std::vector<Eigen::Vector2d> points;
  for (std::size_t k = 0; k < values.size(); k += 2) {
    points.emplace_back(values[k], values[k + 1]);
  }
  return points;
}

}  // namespace plumbline::internal
