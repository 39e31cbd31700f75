#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "match/neighbour_correlation.h"
#include "match/planar_field.h"
#include "track/internal/window_moments.h"

namespace plumbline::internal {

// What the gauges of one field are fitted to.
struct GaugeData {
  const PlanarField& field;
  const NeighbourCorrelation& correlation;
  Image<double> weight;  // 0 where the point is not to be used
  Image<Eigen::Vector2d> sigma_px;
  int half = 1;  // window = 2 half + 1
  int order = 1;
};

struct GaugeFit {
  int points = 0;
  std::array<int, 4> quarter_points{};  // the window without its centre, in four turned rectangles
  bool solved = false;                  // the points fix the polynomial
  // At the centre, NaN if not solved; the covariance is that of (du/dx, du/dy, dv/dx, dv/dy).
  Eigen::Matrix2d gradient;
  Eigen::Matrix4d cov_gradient;
};

// The points a quarter of a full window holds.
constexpr int QuarterPoints(int half) { return half * (half + 1); }

// The fits of the gauges centred at the tile's points, row by row. Points whose weight is 0, and
// gauges with fewer than min_points, are not solved.
std::vector<GaugeFit> FitGauges(const GaugeData& data, const GridTile& tile, int min_points);

}  // namespace plumbline::internal
