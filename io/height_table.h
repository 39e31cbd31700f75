#pragma once

#include <filesystem>

#include "fit/height_map.h"

namespace plumbline {

// Heights of two frames at common places and what CompareHeights() says of them, as CSV: a line a
// place that both know, x_mm, y_mm, height_mm, other_height_mm, difference_mm, sigma_random_mm,
// sigma_calibration_mm (of the difference). All of one grid. Throws EnvironmentError naming the
// file.
void ExportHeights(const std::filesystem::path& file, const HeightMap& heights,
                   const HeightMap& other, const HeightDifference& difference);

}  // namespace plumbline
