#pragma once

#include <array>
#include <memory>
#include <string_view>
#include <vector>

#include "io/internal/frame_packer.h"

namespace plumbline::internal {

// Of the series of a stereo rig: writes the groups of points, /frames and the groups of
// RecordGroups().
std::unique_ptr<FramePacker> MakeStereoPacker(hid_t file, const SeriesShape& shape);

// Attribute `frame` of what is given along the axes of Surface::frame. One entry a frame each:
// SurfaceFrame, and whether there is a surface. Throws std::out_of_range on an unknown code.
void WriteFrameOfPositions(hid_t file, const std::vector<std::uint8_t>& surface_frame,
                           const std::vector<std::uint8_t>& has_surface);

inline constexpr std::array<std::string_view, 2> kFrameStatusNames = {"ok", "no_surface"};
inline constexpr std::array<std::string_view, 2> kSurfaceFrameNames = {"rig", "ground"};
inline constexpr std::array<std::string_view, 2> kFoundNames = {"ok", "not_found"};

}  // namespace plumbline::internal
