#pragma once

#include <Eigen/Core>
#include <compare>
#include <cstdint>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// The edge of a grid between two neighbouring nodes: from node (column i, row j) to the next one
// along the row (axis 0) or along the column (axis 1).
struct GridEdge {
  int i = 0, j = 0, axis = 0;
  auto operator<=>(const GridEdge&) const = default;
};

// The outlines of a set of nodes (not 0), by marching squares: closed loops of the edges that they
// cross, the inside to their left where rows go up from x to y; holes run the other way round.
// Nodes beyond the grid are outside: an outline crosses edges that stick out of it by one (i or j
// of -1, or the last column or row). Inside nodes that touch by a corner alone are
// apart.
std::vector<std::vector<GridEdge>> OutlinesOf(const Image<std::uint8_t>& inside);

using Polygon = std::vector<Eigen::Vector2d>;  // closed, the first point not repeated

// Of all polygons together, by Green's theorem: the area to their left less holes, its centroid,
// and the extent of their corners along x and y.
struct PolygonMeasures {
  double area = 0;
  Eigen::Vector2d centroid{0, 0};
  Eigen::Vector2d low{0, 0}, high{0, 0};
};
PolygonMeasures MeasurePolygons(const std::vector<Polygon>& polygons);

}  // namespace plumbline
