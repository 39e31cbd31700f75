#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"
#include "io/internal/hdf5.h"
#include "io/internal/series_contents.h"
#include "io/series_shard.h"

// Datasets as both kinds of series have them. Throws hdf5::Error.
namespace plumbline::internal {

// Root attribute `geometry` of a series of one camera; that of a stereo rig has none.
inline constexpr const char* kPlanar = "planar";
bool IsPlanar(hid_t file);

// Root attribute `format_version`; 1 where it is none that is read.
std::int64_t VersionOf(hid_t file);

// Root attributes of a shard; nothing is written where it is none.
void WriteShardAttributes(hid_t file, const std::optional<SeriesShard>& shard);
// Nothing: it is none. Throws where they are no part of a whole.
std::optional<SeriesShard> ReadShardAttributes(hid_t file);
void RemoveShardAttributes(hid_t file);
bool IsOfShard(const std::string& attribute);

// What a series holds, by the groups that are there.
template <typename Contents>
Contents ContentsOf(hid_t file) {
  Contents contents;
  for (const OptionalContent<Contents>& content : OptionalContents<Contents>::list) {
    contents.*content.flag = hdf5::Exists(file, std::string(content.path));
  }
  return contents;
}

// An axis whose entries have names.
void WriteNameAxis(hid_t file, const std::string& path, const std::string& label,
                   const std::string& long_name, const std::vector<std::string>& names);

// A dataset of bytes with names, and the names as attributes that other conventions know (CF:
// flag_values, flag_meanings).
hdf5::Id CreateEnumDataset(hid_t file, const hdf5::DatasetSpec& spec,
                           std::span<const std::string_view> names, std::uint8_t fill);

// /grid: where the points sit, in pixels of the image that `long_name` says. Returns the group.
struct GridFacts {
  Image<Eigen::Vector2f> pixel;
  int step_px = 1;
  int subset_px = 0;
};
hdf5::Id WriteGrid(hid_t file, const GridFacts& grid, const std::string& pixel_long_name);

// Makes /frames with its axis.
void WriteFrameIndex(hid_t file, const std::vector<std::int64_t>& index);

// Columns with one entry a frame, anywhere in the file, once /frames is there.
void WriteTextColumn(hid_t file, const std::string& path, const std::string& long_name,
                     const std::vector<std::string>& values);
void WriteEnumColumn(hid_t file, const std::string& path, const std::string& long_name,
                     std::span<const std::string_view> names,
                     const std::vector<std::uint8_t>& values);
template <typename T>
void WriteNumberColumn(hid_t file, const std::string& path, const std::string& units,
                       const std::string& long_name, const std::vector<T>& values) {
  hdf5::AttachScales(
      file, hdf5::WriteArray<T>(file, {path, units, long_name, {values.size()}, {}}, values),
      {"/frames/index"});
}

// get(frame) of every frame.
template <typename T, typename Frame, typename Get>
std::vector<T> Column(const std::vector<Frame>& frames, const Get& get) {
  std::vector<T> column;
  for (const Frame& frame : frames) column.push_back(static_cast<T>(get(frame)));
  return column;
}

}  // namespace plumbline::internal
