#pragma once

#include <filesystem>
#include <string>

#include "fit/cross_section.h"
#include "io/series_frame.h"

namespace plumbline {

// "x=150" (a lateral section) or "y=0" (a longitudinal one), mm in the frame of the positions.
// Throws UsageError for anything else.
CutPlane ParseSection(const std::string& text);

// The line in which a plane cuts the surface of a frame (CutSurface), as CSV: along_mm, up_mm,
// x_mm, y_mm, z_mm, sigma_random_mm, sigma_calibration_mm (of the line, perpendicular to it in the
// plane). A line of nan parts two pieces. Returns the number of points.
//
// The file of a run holds sigmas of single components: these are taken as independent of each other
// for the random part and as one common error for the calibration's. step_px, subset_px: of the
// run, for what neighbours have in common.
// Throws EnvironmentError naming the file.
std::size_t ExportSection(const std::filesystem::path& file, const SeriesFrame& frame,
                          const CutPlane& plane, int step_px, int subset_px);

}  // namespace plumbline
