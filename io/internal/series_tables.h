#pragma once

#include <array>
#include <string_view>
#include <vector>

#include "io/internal/hdf5.h"
#include "io/series_writer.h"

namespace plumbline::internal {

// Writes /frames and the groups of RecordGroups(), one row a frame; the frames' images and contours
// are not looked at. `has_surface` tells for each frame whether the file holds points. Throws
// hdf5::Error.
void WriteFrameTables(hid_t file, const SeriesContents& contents,
                      const std::vector<SeriesFrame>& frames,
                      const std::vector<std::uint8_t>& has_surface);

// What a series holds, by the groups that are there.
SeriesContents ContentsOf(hid_t file);

// An axis whose entries have names.
void WriteNameAxis(hid_t file, const std::string& path, const std::string& label,
                   const std::string& long_name, const std::vector<std::string>& names);

// A dataset of bytes with names, and the names as attributes that other conventions know (CF:
// flag_values, flag_meanings).
hdf5::Id CreateEnumDataset(hid_t file, const hdf5::DatasetSpec& spec,
                           std::span<const std::string_view> names, std::uint8_t fill);

inline constexpr std::array<std::string_view, 2> kFrameStatusNames = {"ok", "no_surface"};
inline constexpr std::array<std::string_view, 2> kSurfaceFrameNames = {"rig", "ground"};
inline constexpr std::array<std::string_view, 2> kFoundNames = {"ok", "not_found"};

}  // namespace plumbline::internal
