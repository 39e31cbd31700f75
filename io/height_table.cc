#include "io/height_table.h"

#include <cmath>

#include "io/internal/table_file.h"

namespace plumbline {

void ExportHeights(const std::filesystem::path& file, const HeightMap& heights,
                   const HeightMap& other, const HeightDifference& difference) {
  internal::WriteTableFile(file, [&](std::ostream& out) {
    out << "x_mm,y_mm,height_mm,other_height_mm,difference_mm,sigma_random_mm,"
           "sigma_calibration_mm\n";
    const GroundGrid& grid = heights.grid;
    for (int r = 0; r < grid.size.height; ++r) {
      for (int c = 0; c < grid.size.width; ++c) {
        if (!std::isfinite(difference.value_mm(r, c))) continue;
        const Eigen::Vector2d at = grid.At(r, c);
        out << internal::Cell(at.x()).substr(1) << internal::Cell(at.y())
            << internal::Cell(heights.height_mm(r, c)) << internal::Cell(other.height_mm(r, c))
            << internal::Cell(difference.value_mm(r, c))
            << internal::Cell(difference.sigma_random_mm(r, c))
            << internal::Cell(difference.sigma_calibration_mm(r, c)) << '\n';
      }
    }
  });
}

}  // namespace plumbline
