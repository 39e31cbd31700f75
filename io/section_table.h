#pragma once

#include <filesystem>
#include <string>

#include "fit/cross_section.h"
#include "io/series_frame.h"
#include "match/neighbour_correlation.h"

namespace plumbline {

// "x=150" (a lateral section) or "y=0" (a longitudinal one), mm in the frame of the positions.
// Throws UsageError for anything else.
CutPlane ParseSection(const std::string& text);

// The line in which a plane cuts the surface of a frame (CutSurface), as CSV: along_mm, up_mm,
// x_mm, y_mm, z_mm, sigma_random_mm, sigma_calibration_mm (of the line, perpendicular to it in the
// plane). A line of nan parts two pieces. Returns the number of points.
//
// Errors of the points: PointsOf() of io/series_points.h. neighbours: NeighboursOf() the run.
// Throws EnvironmentError naming the file.
std::size_t ExportSection(const std::filesystem::path& file, const SeriesFrame& frame,
                          const CutPlane& plane, const NeighbourCorrelation& neighbours);

}  // namespace plumbline
