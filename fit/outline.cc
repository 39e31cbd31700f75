#include "fit/outline.h"

#include <array>
#include <limits>
#include <map>

namespace plumbline {
namespace {

using NextEdge = std::map<GridEdge, GridEdge>;

// Corners and edges of a cell run round it anticlockwise from the lower left.
void March(int i, int j, const std::array<bool, 4>& inside, NextEdge& next) {
  const std::array<GridEdge, 4> edges = {
      GridEdge{i, j, 0}, {i + 1, j, 1}, {i, j + 1, 0}, {i, j, 1}};
  for (std::size_t k = 0; k < 4; ++k) {
    // Walking round the cell with the inside ending at edge k: the outline comes in there, and
    // leaves at the edge where that stretch of inside corners began.
    if (!inside[k] || inside[(k + 1) % 4]) continue;
    std::size_t begin = k;
    while (inside[(begin + 3) % 4] && begin != (k + 1) % 4) begin = (begin + 3) % 4;
    next[edges[k]] = edges[(begin + 3) % 4];
  }
}

}  // namespace

std::vector<std::vector<GridEdge>> OutlinesOf(const Image<std::uint8_t>& inside) {
  const auto at = [&](int i, int j) {
    return i >= 0 && j >= 0 && i < inside.width() && j < inside.height() && inside(j, i) != 0;
  };
  NextEdge next;
  for (int j = -1; j < inside.height(); ++j) {
    for (int i = -1; i < inside.width(); ++i) {
      March(i, j, {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)}, next);
    }
  }
  std::vector<std::vector<GridEdge>> loops;
  while (!next.empty()) {
    std::vector<GridEdge> loop;
    auto from = next.begin();
    while (from != next.end()) {
      loop.push_back(from->first);
      const GridEdge onward = from->second;
      next.erase(from);
      from = next.find(onward);
    }
    loops.push_back(std::move(loop));
  }
  return loops;
}

PolygonMeasures MeasurePolygons(const std::vector<Polygon>& polygons) {
  PolygonMeasures measures;
  measures.low.setConstant(std::numeric_limits<double>::infinity());
  measures.high = -measures.low;
  Eigen::Vector2d moment(0, 0);
  for (const Polygon& polygon : polygons) {
    for (std::size_t k = 0; k < polygon.size(); ++k) {
      const Eigen::Vector2d &a = polygon[k], &b = polygon[(k + 1) % polygon.size()];
      const double cross = a.x() * b.y() - a.y() * b.x();
      measures.area += cross / 2;
      moment += cross / 6 * (a + b);
      measures.low = measures.low.cwiseMin(a);
      measures.high = measures.high.cwiseMax(a);
    }
  }
  measures.centroid = moment / measures.area;
  return measures;
}

}  // namespace plumbline
