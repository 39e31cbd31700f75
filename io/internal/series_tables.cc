#include "io/internal/series_tables.h"

#include <array>
#include <cctype>
#include <cmath>
#include <limits>

#include "io/internal/series_records.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;
using Frames = std::vector<SeriesFrame>;

template <typename T, typename Get>
std::vector<T> Column(const Frames& frames, const Get& get) {
  std::vector<T> column;
  for (const SeriesFrame& frame : frames) column.push_back(static_cast<T>(get(frame)));
  return column;
}

void WriteEnum(hid_t file, const std::string& path, const std::string& long_name,
               std::span<const std::string_view> names, const std::vector<std::uint8_t>& values) {
  const Id dataset = CreateEnumDataset(file, {path, "1", long_name, {values.size()}, {}}, names, 0);
  if (!values.empty()) {
    const Id type = hdf5::EnumType(names);
    hdf5::Check(H5Dwrite(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
                "writing a column");
  }
  hdf5::AttachScales(file, dataset, {"/frames/index"});
}

void WriteFrames(hid_t file, const Frames& frames, const std::vector<std::uint8_t>& has_surface) {
  const hsize_t F = frames.size();
  const Id group = hdf5::CreateGroup(file, "/frames");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "time_s");
  hdf5::SetTexts(group.get(), "axes", {"index"});
  hdf5::MakeScale(hdf5::WriteArray<std::int64_t>(
                      file, {"/frames/index", "1", "position in the recording, from 0", {F}, {}},
                      Column<std::int64_t>(frames, [](const auto& f) { return f.index; })),
                  "frame");
  const std::vector<std::string> axis = {"/frames/index"};
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<double>(file, {"/frames/time_s", "s", "time of the frame", {F}, {}},
                               Column<double>(frames, [](const auto& f) { return f.time_s; })),
      axis);
  const auto texts = [&](const std::string& path, const std::string& long_name, auto get) {
    hdf5::AttachScales(
        file,
        hdf5::WriteTexts(file, {path, "1", long_name, {F}, {}}, Column<std::string>(frames, get)),
        axis);
  };
  texts("/frames/left_id", "left image", [](const auto& f) { return f.left_id; });
  texts("/frames/right_id", "right image", [](const auto& f) { return f.right_id; });
  texts("/frames/problem", "why there is no surface; empty if there is one",
        [](const auto& f) { return f.problem; });
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<std::int32_t>(
          file, {"/frames/dropped_before", "1", "frames lost just before this one", {F}, {}},
          Column<std::int32_t>(frames, [](const auto& f) { return f.dropped_before; })),
      axis);
  std::vector<std::uint8_t> status;
  for (const std::uint8_t has : has_surface) status.push_back(has != 0 ? 0 : 1);
  WriteEnum(file, "/frames/status", "whether the frame holds a surface", kFrameStatusNames, status);
  WriteEnum(file, "/frames/surface_frame", "frame that the positions are given in",
            kSurfaceFrameNames,
            Column<std::uint8_t>(frames, [](const auto& f) { return f.surface.frame; }));
}

void WriteField(hid_t file, const RecordGroup& group, const RecordField& field,
                const Frames& frames) {
  hdf5::Shape shape = {frames.size()};
  std::vector<std::string> scales = {"/frames/index"};
  for (std::size_t d = 0; d < field.axes.size(); ++d) {
    shape.push_back(static_cast<hsize_t>(field.shape[d]));
    const bool is_index = std::isdigit(static_cast<unsigned char>(field.axes[d][0])) != 0;
    scales.push_back(is_index ? hdf5::IndexScale(file, shape.back())
                              : group.path + "/" + field.axes[d]);
  }
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> values;
  for (const SeriesFrame& frame : frames) {
    const Eigen::MatrixXd value = field.get(frame);
    const bool found = group.found(frame);
    for (Eigen::Index r = 0; r < value.rows(); ++r) {
      for (Eigen::Index c = 0; c < value.cols(); ++c) {
        values.push_back(found && std::isfinite(value(r, c)) ? value(r, c) : kNaN);
      }
    }
  }
  hdf5::AttachScales(
      file,
      hdf5::WriteArray<double>(
          file, {group.path + "/" + field.name, field.units, field.long_name, shape, {}}, values),
      scales);
}

void WriteRecords(hid_t file, const RecordGroup& group, const Frames& frames) {
  const Id id = hdf5::CreateGroup(file, group.path);
  if (!group.signal.empty()) {
    hdf5::SetText(id.get(), "NX_class", "NXdata");
    hdf5::SetText(id.get(), "signal", group.signal);
    hdf5::SetTexts(id.get(), "axes", {"frame"});
    hdf5::HardLink(file, "/frames/index", group.path + "/frame");
  }
  for (const RecordAxis& axis : group.axes) {
    WriteNameAxis(file, group.path + "/" + axis.name, axis.name, axis.long_name, axis.labels);
  }
  for (const RecordField& field : group.fields) WriteField(file, group, field, frames);
  WriteEnum(file, group.path + "/status", "whether a " + group.what + " was found", kFoundNames,
            Column<std::uint8_t>(frames, [&](const auto& f) { return group.found(f) ? 0 : 1; }));
  hdf5::AttachScales(file,
                     hdf5::WriteTexts(file,
                                      {group.path + "/problem",
                                       "1",
                                       "why there is no " + group.what + "; empty if there is one",
                                       {frames.size()},
                                       {}},
                                      Column<std::string>(frames, group.problem)),
                     {"/frames/index"});
}

}  // namespace

Id CreateEnumDataset(hid_t file, const hdf5::DatasetSpec& spec,
                     std::span<const std::string_view> names, std::uint8_t fill) {
  const Id type = hdf5::EnumType(names);
  Id dataset = hdf5::CreateDataset(file, spec, type.get(), &fill);
  std::string meanings;
  for (const std::string_view name : names) {
    if (!meanings.empty()) meanings += ' ';
    meanings += name;
  }
  hdf5::SetText(dataset.get(), "flag_meanings", meanings);
  const hsize_t n = names.size();
  std::vector<std::uint8_t> values(n);
  for (std::size_t i = 0; i < n; ++i) values[i] = static_cast<std::uint8_t>(i);
  const Id space(hdf5::Check(H5Screate_simple(1, &n, nullptr), "attribute"));
  const Id attribute(hdf5::Check(H5Acreate2(dataset.get(), "flag_values", H5T_NATIVE_UINT8,
                                            space.get(), H5P_DEFAULT, H5P_DEFAULT),
                                 "attribute"));
  hdf5::Check(H5Awrite(attribute.get(), H5T_NATIVE_UINT8, values.data()), "attribute");
  return dataset;
}

void WriteNameAxis(hid_t file, const std::string& path, const std::string& label,
                   const std::string& long_name, const std::vector<std::string>& names) {
  hdf5::MakeScale(hdf5::WriteTexts(file, {path, "1", long_name, {names.size()}, {}}, names), label);
}

SeriesContents ContentsOf(hid_t file) {
  SeriesContents contents;
  for (const OptionalContent& content : kOptionalContents) {
    contents.*content.flag = hdf5::Exists(file, std::string(content.path));
  }
  return contents;
}

void WriteFrameTables(hid_t file, const SeriesContents& contents, const Frames& frames,
                      const std::vector<std::uint8_t>& has_surface) {
  WriteFrames(file, frames, has_surface);
  for (const RecordGroup& group : RecordGroups()) {
    if (Holds(contents, group.needs)) WriteRecords(file, group, frames);
  }
}

}  // namespace plumbline::internal
