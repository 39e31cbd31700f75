#pragma once

#include <filesystem>

#include "io/series_reader.h"

namespace plumbline {

// CSV with a line for every frame and one heading line that names the units: index, time_s, problem
// (quoted; empty where there is none), valid_points, then what the series holds of each frame as a
// whole, each number followed by sigma_random_... and sigma_calibration_...: tilt of the ground;
// angle, speed and place of the wheel; area, length, width and centroid of the contact patch; slip
// ratio, angle and speed; rotation of the rig; deformation of the wheel; the rigid motion; the
// cameras' watch. Angles in degrees. `nan`: not measured.
//
// Memory: that of one frame. Throws EnvironmentError naming the file, InputError as
// SeriesReader::Frame.
void ExportFrameTable(const std::filesystem::path& file, const SeriesReader& series);

}  // namespace plumbline
