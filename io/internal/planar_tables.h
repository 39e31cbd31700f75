#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "io/internal/frame_packer.h"

namespace plumbline::internal {

// Of the series of one camera: writes the groups of points and /frames.
std::unique_ptr<FramePacker> MakePlanarPacker(hid_t file, const SeriesShape& shape);

inline constexpr std::array<std::string_view, 2> kPlanarFrameStatusNames = {"ok", "no_field"};

}  // namespace plumbline::internal
