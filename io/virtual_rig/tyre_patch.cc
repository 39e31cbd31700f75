#include "io/virtual_rig/tyre_patch.h"

#include <cmath>
#include <cstdint>
#include <functional>

#include "fit/outline.h"

namespace plumbline {
namespace {

// The tyre is searched for contact so far from the bottom: farther than the highest obstacle
// reaches.
constexpr double kHalfLength_rad = 0.9;

using Level = std::function<double(const Eigen::Vector2d&)>;

// Material cells, and the zero line of a level over them; inside is where it is not positive.
class Cells {
 public:
  Cells(const Level& level, const Eigen::Vector2d& corner, double spacing)
      : level_(level), corner_(corner), spacing_(spacing) {}

  // The outer ring counts as outside, so that the search for the zero line never leaves the cells.
  Image<std::uint8_t> Inside(int columns, int rows) const {
    Image<std::uint8_t> inside({columns + 1, rows + 1}, 0);
    for (int j = 1; j < rows; ++j) {
      for (int i = 1; i < columns; ++i) inside(j, i) = level_(Node(i, j)) <= 0 ? 1 : 0;
    }
    return inside;
  }

  Eigen::Vector2d Crossing(const GridEdge& edge) const {
    Eigen::Vector2d a = Node(edge.i, edge.j);
    Eigen::Vector2d b = edge.axis == 0 ? Node(edge.i + 1, edge.j) : Node(edge.i, edge.j + 1);
    const bool a_inside = level_(a) <= 0;
    for (int k = 0; k < 24; ++k) {
      const Eigen::Vector2d middle = (a + b) / 2;
      ((level_(middle) <= 0) == a_inside ? a : b) = middle;
    }
    return (a + b) / 2;
  }

 private:
  Eigen::Vector2d Node(int i, int j) const { return corner_ + spacing_ * Eigen::Vector2d(i, j); }

  const Level& level_;
  Eigen::Vector2d corner_;
  double spacing_;
};

}  // namespace

std::optional<TyrePatch> FindPatch(const TyreSurface& tyre, double time_s, double threshold_mm,
                                   double spacing_mm) {
  const auto contact = tyre.Contact(time_s);
  if (!contact) return std::nullopt;
  const Level level = [&](const Eigen::Vector2d& m) {
    return threshold_mm > 0 ? contact->Gap(m) - threshold_mm : contact->Level(m);
  };
  const double radius = tyre.options().section.crown_radius_mm;
  const double bottom = tyre.Wheel(time_s).angle_rad * radius;
  const Eigen::Vector2d half(kHalfLength_rad * radius, tyre.Domain().v_max);
  const Cells cells(level, Eigen::Vector2d(bottom, 0) - half, spacing_mm);
  const auto cells_along = [&](double length) {
    return static_cast<int>(std::ceil(length / spacing_mm));
  };
  const auto instant = tyre.At(time_s);
  TyrePatch patch;
  for (const std::vector<GridEdge>& loop :
       OutlinesOf(cells.Inside(cells_along(2 * half.x()), cells_along(2 * half.y())))) {
    Polygon contour;
    for (const GridEdge& edge : loop) {
      contour.emplace_back(instant->At(cells.Crossing(edge)).position_mm.head<2>());
    }
    patch.contours_mm.push_back(std::move(contour));
  }
  const PolygonMeasures measures = MeasurePolygons(patch.contours_mm);
  if (!(measures.area > 0)) return std::nullopt;
  patch.area_mm2 = measures.area;
  patch.centroid_mm = measures.centroid;
  patch.length_mm = measures.high.x() - measures.low.x();
  patch.width_mm = measures.high.y() - measures.low.y();
  return patch;
}

}  // namespace plumbline
