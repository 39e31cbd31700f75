#include "io/internal/series_datasets.h"

#include <algorithm>
#include <numeric>

#include "io/internal/rig_group.h"

namespace plumbline::internal {
namespace {

using hdf5::Id;

void WriteIndexAxis(hid_t file, const std::string& path, const std::string& label, int n,
                    const std::string& long_name) {
  std::vector<std::int32_t> values(static_cast<std::size_t>(n));
  std::iota(values.begin(), values.end(), 0);
  hdf5::MakeScale(hdf5::WriteArray<std::int32_t>(
                      file, {path, "1", long_name, {static_cast<hsize_t>(n)}, {}}, values),
                  label);
}

}  // namespace

bool IsPlanar(hid_t file) { return hdf5::GetText(file, "geometry") == kPlanar; }

std::int64_t VersionOf(hid_t file) {
  const double version = hdf5::GetNumber(file, "format_version", 1);
  return version >= 1 && version <= static_cast<double>(kFormatVersion)
             ? static_cast<std::int64_t>(version)
             : 1;
}

namespace {

constexpr const char* kShardIndex = "shard_index";
constexpr const char* kShardCount = "shard_count";
constexpr const char* kShardFirstFrame = "shard_first_frame";
constexpr const char* kShardFrameCount = "shard_frame_count";
constexpr const char* kShardBlock = "shard_block_frames";

}  // namespace

void WriteShardAttributes(hid_t file, const std::optional<SeriesShard>& shard) {
  if (!shard) return;
  hdf5::SetInteger(file, kShardIndex, shard->index);
  hdf5::SetInteger(file, kShardCount, shard->count);
  hdf5::SetInteger(file, kShardFirstFrame, shard->first_frame);
  hdf5::SetInteger(file, kShardFrameCount, shard->frame_count);
  hdf5::SetInteger(file, kShardBlock, shard->block_frames);
}

std::optional<SeriesShard> ReadShardAttributes(hid_t file) {
  if (!hdf5::HasAttribute(file, kShardIndex)) return std::nullopt;
  const auto whole = [&](const char* name, double most) {
    const double value = hdf5::GetNumber(file, name, -1);
    if (!(value >= 0 && value <= most)) {
      throw hdf5::Error(std::string("the attribute ") + name + " is missing or out of range");
    }
    return static_cast<std::int64_t>(value);
  };
  const SeriesShard shard{static_cast<int>(whole(kShardIndex, 1e6)),
                          static_cast<int>(whole(kShardCount, 1e6)), whole(kShardFirstFrame, 1e15),
                          whole(kShardFrameCount, 1e15), whole(kShardBlock, 1e15)};
  if (shard.index >= shard.count || shard.block_frames < 1 ||
      shard != ShardOf(shard.index, shard.count, shard.frame_count, shard.block_frames)) {
    throw hdf5::Error("the attributes of the shard contradict each other");
  }
  return shard;
}

void RemoveShardAttributes(hid_t file) {
  for (const char* name :
       {kShardIndex, kShardCount, kShardFirstFrame, kShardFrameCount, kShardBlock}) {
    if (hdf5::HasAttribute(file, name)) hdf5::Check(H5Adelete(file, name), "removing an attribute");
  }
}

bool IsOfShard(const std::string& attribute) { return attribute.rfind("shard_", 0) == 0; }

void WriteNameAxis(hid_t file, const std::string& path, const std::string& label,
                   const std::string& long_name, const std::vector<std::string>& names) {
  hdf5::MakeScale(hdf5::WriteTexts(file, {path, "1", long_name, {names.size()}, {}}, names), label);
}

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

Id WriteGrid(hid_t file, const GridFacts& grid, const std::string& pixel_long_name) {
  Id group = hdf5::CreateGroup(file, "/grid");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "pixel");
  hdf5::SetTexts(group.get(), "axes", {"row", "col", "component"});
  WriteIndexAxis(file, "/grid/row", "row", grid.pixel.height(), "row of the grid");
  WriteIndexAxis(file, "/grid/col", "col", grid.pixel.width(), "column of the grid");
  WriteNameAxis(file, "/grid/component", "component", "pixel coordinate", {"x", "y"});
  const auto rows = static_cast<hsize_t>(grid.pixel.height());
  const auto columns = static_cast<hsize_t>(grid.pixel.width());
  const std::span<const float> pixels(grid.pixel.data()->data(), rows * columns * 2);
  const hsize_t band = std::max<hsize_t>(1, std::min(rows, (hsize_t{1} << 17) / columns));
  const Id dataset = hdf5::WriteArray<float>(
      file, {"/grid/pixel", "pixel", pixel_long_name, {rows, columns, 2}, {band, columns, 2}},
      pixels);
  hdf5::AttachScales(file, dataset, {"/grid/row", "/grid/col", "/grid/component"});
  const auto scalar = [&](const char* name, const char* long_name, int value) {
    const std::int32_t v = value;
    hdf5::WriteArray<std::int32_t>(file, {name, "pixel", long_name, {}, {}}, {&v, 1});
  };
  scalar("/grid/step_px", "distance between neighbouring points", grid.step_px);
  scalar("/grid/subset_px", "width of the matcher's window; 0 if it has none", grid.subset_px);
  return group;
}

void WriteFrameIndex(hid_t file, const std::vector<std::int64_t>& index) {
  const Id group = hdf5::CreateGroup(file, "/frames");
  hdf5::SetText(group.get(), "NX_class", "NXdata");
  hdf5::SetText(group.get(), "signal", "time_s");
  hdf5::SetTexts(group.get(), "axes", {"index"});
  hdf5::MakeScale(
      hdf5::WriteArray<std::int64_t>(
          file, {"/frames/index", "1", "position in the recording, from 0", {index.size()}, {}},
          index),
      "frame");
}

void WriteTextColumn(hid_t file, const std::string& path, const std::string& long_name,
                     const std::vector<std::string>& values) {
  hdf5::AttachScales(file,
                     hdf5::WriteTexts(file, {path, "1", long_name, {values.size()}, {}}, values),
                     {"/frames/index"});
}

void WriteEnumColumn(hid_t file, const std::string& path, const std::string& long_name,
                     std::span<const std::string_view> names,
                     const std::vector<std::uint8_t>& values) {
  const Id dataset = CreateEnumDataset(file, {path, "1", long_name, {values.size()}, {}}, names, 0);
  if (!values.empty()) {
    const Id type = hdf5::EnumType(names);
    hdf5::Check(H5Dwrite(dataset.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()),
                "writing a column");
  }
  hdf5::AttachScales(file, dataset, {"/frames/index"});
}

}  // namespace plumbline::internal
