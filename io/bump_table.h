#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "fit/bump.h"
#include "fit/carcass_thickness.h"
#include "io/series_reader.h"

namespace plumbline {

// The bumps of one frame of a run.
struct FrameBumps {
  std::int64_t index = 0;  // SeriesFrame::index
  double time_s = 0;
  double travel_mm = 0;     // TravelOf()
  std::string problem;      // why it was not looked for any
  std::vector<Bump> bumps;  // the highest first; places in the ground frame of the frame
};

// Looks for bumps in every frame of a run whose positions are in a ground frame (FindBumps). Errors
// of the points: PointsOf() of io/series_points.h.
//
// carcass: by place along the axis from the middle of the tread (WheelRecord::centre_mm): of each
// point by where it lies undeformed, so that a map takes a run with a wheel and displacements.
//
// Throws UsageError from the options, InputError where a map has no wheel to count from.
[[nodiscard]] std::vector<FrameBumps> FindBumpsOf(const SeriesReader& series,
                                                  const CarcassThickness& carcass,
                                                  const BumpOptions& options = {});

// As CSV, a line a bump: index, time_s, travel_mm, x_mm, y_mm, height_mm, clearance_mm with both
// sigmas each, width_mm. travel_mm + x_mm tells where on the ground it lies, the same for all
// frames that see it. Throws EnvironmentError naming the file.
void ExportBumps(const std::filesystem::path& file, const std::vector<FrameBumps>& frames);

}  // namespace plumbline
