#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <variant>
#include <vector>

#include "match/neighbour_correlation.h"
#include "track/internal/window_moments.h"
#include "track/planar_strain.h"

namespace plumbline::internal {

// Where the gauges of a grid stand and how far its points' errors go together.
struct GaugeData {
  GaugeData(const NeighbourCorrelation& neighbours, const Image<Eigen::Vector3f>& covariances_px2,
            Image<double> weights, int grid_step_px, int half_window, int polynomial_order);

  const NeighbourCorrelation& correlation;
  const Image<Eigen::Vector3f>& cov_px2;  // uu, uv, vv of the points
  Image<double> weight;                   // 0 where the point is not to be used
  Image<Eigen::Vector2d> sigma_px;
  int step_px;
  int half;  // window = 2 half + 1
  int order;
};

struct GaugeFit {
  int points = 0;
  std::array<int, 4> quarter_points{};  // the window without its centre, in four turned rectangles
  bool solved = false;                  // the points fix the polynomial
  // NaN if not solved. Of a field over the gauge, the gradient at its centre (per px) is
  // filter' sum w P value, P = (1, x, y, x^2, x y, y^2, x^3, ...) in units of the half window, up
  // to the order; the covariance is that of (du/dx, du/dy, dv/dx, dv/dy).
  Eigen::Matrix<double, 10, 2> filter;
  Eigen::Matrix4d cov_gradient;
};

// When a gauge that is not full, at edges and holes, is full enough.
struct GaugeRule {
  GaugeRule(int window_points, double min_share, double min_quarter_share);
  bool IsMetBy(const GaugeFit& fit) const;

  int min_points;
  double min_quarter_points;
};

// The weight of a point in its gauges, by the covariance (uu, uv, vv) of its displacement; 0 where
// that gives none.
double WeightOf(const Eigen::Vector3f& cov_px2, GaugeWeights weights);

// Throws UsageError naming the broken constraint of the options of a strain gauge.
void CheckGauge(int window_points, int min_window_points, int order, double min_share,
                double min_quarter_share);

// What the fit of a gauge follows from, with a polynomial of kTerms terms (3: linear, 6:
// quadratic, 10: cubic).
template <int kTerms>
struct GaugeSums {
  using Matrix = Eigen::Matrix<double, kTerms, kTerms>;
  Matrix normal = Matrix::Zero();  // sum_p w P P'
  // sum_pq w w P P' cov(p, q), by uu, uv, vv.
  std::array<Matrix, 3> pairs{Matrix::Zero(), Matrix::Zero(), Matrix::Zero()};
};

struct TileGauges {
  GridTile tile;
  std::vector<GaugeFit> fits;  // row by row
  std::variant<std::vector<GaugeSums<3>>, std::vector<GaugeSums<6>>, std::vector<GaugeSums<10>>>
      sums;
};

// The fits of the gauges centred at the tile's points. Points whose weight is 0, and gauges with
// fewer than min_points, are not solved.
TileGauges FitGauges(const GaugeData& data, const GridTile& tile, int min_points);

// The same fits where points are missing: those with a weight that have none in `present`. Their
// share is taken out of the sums of the gauges that they touch, which for few missing points costs
// far less than to fit again.
std::vector<GaugeFit> FitsWithoutMissing(const GaugeData& data, const TileGauges& gauges,
                                         const Image<double>& present, int min_points);

// The tiles of a grid: small enough that a tile's sums stay in the cache, large enough that what
// its windows reach around it does not count.
std::vector<GridTile> TilesOf(ImageSize grid);

// Gradients of fields over the gauges of a tile.
class GradientFilter {
 public:
  GradientFilter(const Image<double>& weight, const GridTile& tile, int half, int order)
      : weight_(weight), tile_(tile), order_(order), values_{{{tile, half}}}, moments_(tile) {}

  // Calls store(cell, gradient) at each solved gauge; value(row, column) is asked for where there
  // is a weight.
  template <typename Value, typename Store>
  void Apply(const std::vector<GaugeFit>& fits, const Value& value, const Store& store) {
    const auto weighted = [&](int r, int c) {
      const double w = weight_(r, c);
      return std::array{w > 0 ? w * value(r, c) : 0.0};
    };
    Fill(tile_, weight_.size(), weighted, values_);
    const OffsetRange all{-values_[0].half(), values_[0].half()};
    moments_.Compute(values_[0], all, all, order_);
    for (std::size_t cell = 0; cell < fits.size(); ++cell) {
      if (!fits[cell].solved) continue;
      store(cell, order_ == 1   ? Gradient<3>(fits[cell], cell)
                  : order_ == 2 ? Gradient<6>(fits[cell], cell)
                                : Gradient<10>(fits[cell], cell));
    }
  }

 private:
  template <int kTerms>
  Eigen::RowVector2d Gradient(const GaugeFit& fit, std::size_t cell) const {
    Eigen::Matrix<double, kTerms, 1> sums;
    for (int i = 0; i < kTerms; ++i) sums[i] = moments_(i, cell);
    return sums.transpose() * fit.filter.topRows<kTerms>();
  }

  const Image<double>& weight_;
  GridTile tile_;
  int order_;
  std::array<PaddedTile, 1> values_;
  WindowMoments moments_;
};

}  // namespace plumbline::internal
