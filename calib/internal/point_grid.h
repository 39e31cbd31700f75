#pragma once

#include <Eigen/Core>
#include <map>
#include <utility>
#include <vector>

namespace plumbline::internal {

// A place in a lattice of points; (i + 1, j) and (i, j + 1) are its neighbours along the two basis
// directions, of which the second is clockwise from the first as seen in the image.
using GridPlace = std::pair<int, int>;

// Points put in order: which point lies at which place.
struct PointGrid {
  std::map<GridPlace, int> points;  // index into the input

  bool Has(GridPlace place) const { return points.count(place) != 0; }
};

// What a point must have in common with its neighbours.
struct GridPoint {
  Eigen::Vector2d pixel;
  double size = 1;  // area, px^2
};

// The largest connected lattice among scattered points, grown from place to place: each new point
// is predicted from those already placed near it, so perspective and lens distortion do no harm,
// and one that lies off its prediction by more than a quarter of the spacing is left out. So are
// points less than 0.4 times or more than `largest_ratio` times the size of their neighbour.
// `enough`: stop looking for a larger one when this many points are in order.
PointGrid OrderPoints(const std::vector<GridPoint>& points, std::size_t enough,
                      double largest_ratio = 2.5);

// How a board lies in a lattice: board column and row of a place are those of the place turned by
// `quarter_turns` * 90 degrees and moved by (-column0, -row0).
struct GridPose {
  int quarter_turns = 0;
  int column0 = 0;
  int row0 = 0;

  GridPlace Turned(GridPlace place) const;
  GridPlace BoardPlace(GridPlace place) const;
};

// The direction of growing board column at the middle of the lattice, as an angle in the image
// (radians, 0 = to the right, positive = clockwise).
double ColumnAngle(const PointGrid& grid, const std::vector<GridPoint>& points,
                   const GridPose& pose);

// Of poses that describe the lattice equally well, the one with its columns nearest to the image's
// x axis; -1 when the next best is less than 20 degrees further away (see DetectBoard()).
int NearestToImageAxes(const std::vector<double>& column_angles);

}  // namespace plumbline::internal
