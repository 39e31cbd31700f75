#pragma once

#include <filesystem>

#include "io/planar_series.h"
#include "io/series_writer.h"

namespace plumbline {

// Writes the points of one frame whose status is ok, in row order, to a temporary name that is then
// renamed. Throws EnvironmentError naming the file.
//
// PLY (binary, little endian), vertex properties as 32-bit floats: x y z, sigma_random_x.._z,
// sigma_calibration_x.._z (all mm, one standard deviation), correlation, epipolar_px.
void ExportPly(const std::filesystem::path& file, const SeriesFrame& frame);

// The points of the grid that a table holds: those with a value, or all of them.
enum class CsvPoints { kOk, kAll };

// CSV with one heading line that names the units: row, column, then the same values, and where the
// frame has them displacement (u, v, w) and strain with both sigmas, and strain_status. With kAll
// the whole grid, in row order, with a last column `status` of names (calib/status.h); values that
// are not there are `nan`. A frame without a surface has no points.
void ExportCsv(const std::filesystem::path& file, const SeriesFrame& frame,
               CsvPoints points = CsvPoints::kOk);

// The same of a frame of one camera: row, column, where the point sits in the reference image
// (x_px, y_px), its displacement (u_px, v_px), the sigmas of both, zncc, and with a strain xx, yy,
// xy, their sigmas and strain_status. With kOk the points that have a displacement. The correlation
// may be a number where the status is not ok.
void ExportCsv(const std::filesystem::path& file, const PlanarSeriesFrame& frame,
               CsvPoints points = CsvPoints::kOk);

}  // namespace plumbline
