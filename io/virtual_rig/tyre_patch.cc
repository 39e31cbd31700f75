#include "io/virtual_rig/tyre_patch.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>

namespace plumbline {
namespace {

// The tyre is searched for contact so far from the bottom: farther than the highest obstacle
// reaches.
constexpr double kHalfLength_rad = 0.9;

using Level = std::function<double(const Eigen::Vector2d&)>;

// The zero line of a level over a grid of material cells; inside is where it is not positive.
class Outline {
 public:
  Outline(const Level& level, const Eigen::Vector2d& corner, int columns, int rows, double spacing)
      : level_(level), corner_(corner), columns_(columns), spacing_(spacing) {
    std::vector<double> values;
    for (int j = 0; j <= rows; ++j) {
      for (int i = 0; i <= columns; ++i) values.push_back(level(Node(i, j)));
    }
    // The outer ring counts as outside, so that every outline closes.
    const auto inside = [&](int i, int j) {
      if (i == 0 || j == 0 || i == columns || j == rows) return false;
      return values[static_cast<std::size_t>(j * (columns_ + 1) + i)] <= 0;
    };
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) {
        March(i, j, {inside(i, j), inside(i + 1, j), inside(i + 1, j + 1), inside(i, j + 1)});
      }
    }
  }

  // Closed loops of material points, the inside to their left.
  std::vector<std::vector<Eigen::Vector2d>> Loops() {
    std::vector<std::vector<Eigen::Vector2d>> loops;
    while (!next_.empty()) {
      std::vector<Eigen::Vector2d> loop;
      auto at = next_.begin();
      while (at != next_.end()) {
        loop.push_back(Crossing(at->first));
        const Edge onward = at->second;
        next_.erase(at);
        at = next_.find(onward);
      }
      loops.push_back(std::move(loop));
    }
    return loops;
  }

 private:
  // From node (i, j) along u (0) or along v (1).
  struct Edge {
    int i, j, axis;
    auto operator<=>(const Edge&) const = default;
  };

  Eigen::Vector2d Node(int i, int j) const { return corner_ + spacing_ * Eigen::Vector2d(i, j); }

  // Corners and edges of a cell run round it anticlockwise from the lower left.
  void March(int i, int j, const std::array<bool, 4>& inside) {
    const std::array<Edge, 4> edges = {Edge{i, j, 0}, {i + 1, j, 1}, {i, j + 1, 0}, {i, j, 1}};
    for (std::size_t k = 0; k < 4; ++k) {
      // Walking round the cell with the inside ending at edge k: the outline comes in there, and
      // leaves at the edge where that stretch of inside corners began.
      if (!inside[k] || inside[(k + 1) % 4]) continue;
      std::size_t begin = k;
      while (inside[(begin + 3) % 4] && begin != (k + 1) % 4) begin = (begin + 3) % 4;
      next_[edges[k]] = edges[(begin + 3) % 4];
    }
  }

  Eigen::Vector2d Crossing(const Edge& edge) const {
    Eigen::Vector2d a = Node(edge.i, edge.j);
    Eigen::Vector2d b = edge.axis == 0 ? Node(edge.i + 1, edge.j) : Node(edge.i, edge.j + 1);
    const bool a_inside = level_(a) <= 0;
    for (int k = 0; k < 24; ++k) {
      const Eigen::Vector2d middle = (a + b) / 2;
      ((level_(middle) <= 0) == a_inside ? a : b) = middle;
    }
    return (a + b) / 2;
  }

  const Level& level_;
  Eigen::Vector2d corner_;
  int columns_;
  double spacing_;
  std::map<Edge, Edge> next_;
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
  Outline outline(level, Eigen::Vector2d(bottom, 0) - half,
                  static_cast<int>(std::ceil(2 * half.x() / spacing_mm)),
                  static_cast<int>(std::ceil(2 * half.y() / spacing_mm)), spacing_mm);
  const auto instant = tyre.At(time_s);
  TyrePatch patch;
  Eigen::AlignedBox2d extent;
  Eigen::Vector2d moment(0, 0);
  for (const auto& loop : outline.Loops()) {
    std::vector<Eigen::Vector2d> contour;
    for (const Eigen::Vector2d& m : loop) {
      contour.emplace_back(instant->At(m).position_mm.head<2>());
    }
    for (std::size_t k = 0; k < contour.size(); ++k) {
      const Eigen::Vector2d &a = contour[k], &b = contour[(k + 1) % contour.size()];
      const double cross = a.x() * b.y() - a.y() * b.x();
      patch.area_mm2 += cross / 2;
      moment += cross / 6 * (a + b);
      extent.extend(a);
    }
    patch.contours_mm.push_back(std::move(contour));
  }
  if (!(patch.area_mm2 > 0)) return std::nullopt;
  patch.centroid_mm = moment / patch.area_mm2;
  patch.length_mm = extent.sizes().x();
  patch.width_mm = extent.sizes().y();
  return patch;
}

}  // namespace plumbline
