#include "track/internal/gauge_fit.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <utility>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kTileRows = 32, kTileColumns = 64;

enum Block : std::uint8_t { kUu, kUv, kVv };

// Of the terms of a polynomial, in the order of MomentIndex().
constexpr std::array<int, 10> kPowersOfX = {0, 1, 0, 2, 1, 0, 3, 2, 1, 0},
                              kPowersOfY = {0, 0, 1, 0, 1, 2, 0, 1, 2, 3};
int PowerOfX(int term) { return kPowersOfX[static_cast<std::size_t>(term)]; }
int PowerOfY(int term) { return kPowersOfY[static_cast<std::size_t>(term)]; }

// P(x + dx, y + dy) = shift P(x, y) for the terms P.
template <int kTerms>
Eigen::Matrix<double, kTerms, kTerms> ShiftOf(double dx, double dy) {
  constexpr double kChoose[4][4] = {{1, 0, 0, 0}, {1, 1, 0, 0}, {1, 2, 1, 0}, {1, 3, 3, 1}};
  Eigen::Matrix<double, kTerms, kTerms> shift = Eigen::Matrix<double, kTerms, kTerms>::Zero();
  for (int i = 0; i < kTerms; ++i) {
    const int a = PowerOfX(i), b = PowerOfY(i);
    for (int j = 0; j < kTerms; ++j) {
      const int c = PowerOfX(j), d = PowerOfY(j);
      if (c > a || d > b) continue;
      shift(i, j) = kChoose[a][c] * kChoose[b][d] * std::pow(dx, a - c) * std::pow(dy, b - d);
    }
  }
  return shift;
}

// w_p w_q cov(d_p, d_q) of p = (r, c) and q = p + (dr, dc), by uu, uv, vu, vv; zero where one of
// them is not there.
std::array<double, 4> PairCovariance(const GaugeData& data, int r, int c, int dr, int dc) {
  const ImageSize size = data.weight.size();
  const int to_r = r + dr, to_c = c + dc;
  if (to_r < 0 || to_r >= size.height || to_c < 0 || to_c >= size.width) return {};
  const double weight = data.weight(r, c) * data.weight(to_r, to_c);
  if (!(weight > 0)) return {};
  if (dr == 0 && dc == 0) {
    const Eigen::Vector3d own = data.cov_px2(r, c).cast<double>();
    return {weight * own[0], weight * own[1], weight * own[1], weight * own[2]};
  }
  const Eigen::Matrix2f R = data.correlation.Between(r, c, dr, dc);
  const Eigen::Vector2d& p = data.sigma_px(r, c);
  const Eigen::Vector2d& q = data.sigma_px(to_r, to_c);
  return {weight * p[0] * R(0, 0) * q[0], weight * p[0] * R(0, 1) * q[1],
          weight * p[1] * R(1, 0) * q[0], weight * p[1] * R(1, 1) * q[1]};
}

// Grid steps beyond which two points of one gauge are independent.
int ReachOf(const GaugeData& data) { return std::min(data.correlation.reach(), 2 * data.half); }

template <int kTerms>
void Solve(const GaugeData& data, const GaugeSums<kTerms>& sums, GaugeFit& fit) {
  constexpr double kSmallestPivot = 1e-9;
  using Matrix = typename GaugeSums<kTerms>::Matrix;
  fit.filter.setConstant(kNan);
  fit.cov_gradient.setConstant(kNan);
  if (!fit.solved) return;
  const Eigen::LDLT<Matrix> solver(sums.normal);
  const auto pivots = solver.vectorD();
  fit.solved = pivots.minCoeff() > kSmallestPivot * pivots.maxCoeff();
  if (!fit.solved) return;
  const double per_px = 1.0 / (data.half * data.step_px);
  const Eigen::Matrix<double, kTerms, 2> rows =
      per_px * solver.solve(Matrix::Identity()).template middleCols<2>(1);
  fit.filter.setZero();
  fit.filter.topRows<kTerms>() = rows;
  const auto block = [&](Block which) -> Eigen::Matrix2d {
    return rows.transpose() * sums.pairs[which] * rows;
  };
  fit.cov_gradient.topLeftCorner<2, 2>() = block(kUu);
  fit.cov_gradient.bottomRightCorner<2, 2>() = block(kVv);
  fit.cov_gradient.topRightCorner<2, 2>() = block(kUv);
  fit.cov_gradient.bottomLeftCorner<2, 2>() = fit.cov_gradient.topRightCorner<2, 2>().transpose();
}

// The fits of one tile by a polynomial of kTerms terms, whose coordinates are in units of the half
// window.
template <int kTerms>
class TileFit {
 public:
  TileFit(const GaugeData& data, const GridTile& tile, int min_points)
      : data_(data),
        tile_(tile),
        min_points_(min_points),
        covariances_{{{tile, data.half}, {tile, data.half}, {tile, data.half}, {tile, data.half}}},
        values_{{{tile, data.half}}},
        moments_(tile),
        fits_(tile.cells()),
        sums_(tile.cells()) {}

  TileGauges Run() {
    Count();
    SumNormalEquations();
    const int reach = ReachOf(data_);
    for (int dr = 0; dr <= reach; ++dr) {
      for (int dc = dr == 0 ? 0 : -reach; dc <= reach; ++dc) AddPairs(dr, dc);
    }
    for (std::size_t cell = 0; cell < fits_.size(); ++cell) Solve(data_, sums_[cell], fits_[cell]);
    return {tile_, std::move(fits_), std::move(sums_)};
  }

 private:
  using Matrix = typename GaugeSums<kTerms>::Matrix;
  static constexpr int kOrder = kTerms == 3 ? 1 : kTerms == 6 ? 2 : 3;

  void Count();
  void SumNormalEquations();
  void AddPairs(int dr, int dc);
  void AddBlock(Block block, const Matrix& shift, bool direct, bool mirrored);
  Matrix Outer(std::size_t cell) const;

  const GaugeData& data_;
  const GridTile tile_;
  const int min_points_;
  // By uu, uv, vu, vv.
  std::array<PaddedTile, 4> covariances_;
  std::array<PaddedTile, 1> values_;
  WindowMoments moments_;
  std::vector<GaugeFit> fits_;
  std::vector<GaugeSums<kTerms>> sums_;
};

template <int kTerms>
void TileFit<kTerms>::Count() {
  const int h = data_.half;
  const auto is_there = [&](int r, int c) {
    return std::array{data_.weight(r, c) > 0 ? 1.0 : 0.0};
  };
  Fill(tile_, data_.weight.size(), is_there, values_);
  const auto count = [&](OffsetRange x, OffsetRange y, const auto& store) {
    moments_.Compute(values_[0], x, y, 0);
    for (std::size_t cell = 0; cell < fits_.size(); ++cell)
      store(fits_[cell], static_cast<int>(std::lround(moments_(0, cell))));
  };
  count({-h, h}, {-h, h}, [](GaugeFit& fit, int n) { fit.points = n; });
  const OffsetRange before{-h, -1}, to_centre{-h, 0}, from_centre{0, h}, after{1, h};
  count(before, to_centre, [](GaugeFit& fit, int n) { fit.quarter_points[0] = n; });
  count(from_centre, before, [](GaugeFit& fit, int n) { fit.quarter_points[1] = n; });
  count(after, from_centre, [](GaugeFit& fit, int n) { fit.quarter_points[2] = n; });
  count(to_centre, after, [](GaugeFit& fit, int n) { fit.quarter_points[3] = n; });
  for (std::size_t cell = 0; cell < fits_.size(); ++cell) {
    const int r = tile_.RowOf(cell), c = tile_.ColumnOf(cell);
    fits_[cell].solved =
        data_.weight(r, c) > 0 && fits_[cell].points >= std::max(min_points_, kTerms);
  }
}

// sum v P P' from the moments of v.
template <int kTerms>
typename TileFit<kTerms>::Matrix TileFit<kTerms>::Outer(std::size_t cell) const {
  Matrix out;
  for (int i = 0; i < kTerms; ++i) {
    for (int j = 0; j < kTerms; ++j)
      out(i, j) = moments_(MomentIndex(PowerOfX(i) + PowerOfX(j), PowerOfY(i) + PowerOfY(j)), cell);
  }
  return out;
}

template <int kTerms>
void TileFit<kTerms>::SumNormalEquations() {
  const OffsetRange all{-data_.half, data_.half};
  const ImageSize size = data_.weight.size();
  Fill(
      tile_, size, [&](int r, int c) { return std::array{data_.weight(r, c)}; }, values_);
  moments_.Compute(values_[0], all, all, 2 * kOrder);
  for (std::size_t cell = 0; cell < fits_.size(); ++cell) sums_[cell].normal = Outer(cell);
}

// All pairs of points p and q = p + (dr, dc), and the same pairs named the other way round.
template <int kTerms>
void TileFit<kTerms>::AddPairs(int dr, int dc) {
  const int h = data_.half;
  const bool same = dr == 0 && dc == 0;
  // Both points inside the window.
  const OffsetRange x{std::max(-h, -h - dc), std::min(h, h - dc)}, y{-h, h - dr};
  // P(x_q) = shift P(x_p)
  const Matrix shift = ShiftOf<kTerms>(static_cast<double>(dc) / h, static_cast<double>(dr) / h);
  Fill(
      tile_, data_.weight.size(), [&](int r, int c) { return PairCovariance(data_, r, c, dr, dc); },
      covariances_);
  const auto add = [&](int component, Block block, bool direct, bool mirrored) {
    moments_.Compute(covariances_[static_cast<std::size_t>(component)], x, y, 2 * kOrder);
    AddBlock(block, shift, direct, mirrored);
  };
  add(0, kUu, true, !same);
  add(1, kUv, true, false);
  if (!same) add(2, kUv, false, true);
  add(3, kVv, true, !same);
}

template <int kTerms>
void TileFit<kTerms>::AddBlock(Block block, const Matrix& shift, bool direct, bool mirrored) {
  for (std::size_t cell = 0; cell < fits_.size(); ++cell) {
    if (!fits_[cell].solved) continue;
    const Matrix sum = Outer(cell) * shift.transpose();
    if (direct) sums_[cell].pairs[block] += sum;
    if (mirrored) sums_[cell].pairs[block] += sum.transpose();
  }
}

// Takes points that are missing out of the gauges of a tile. With M the missing points of a gauge
// and N those that are left,
//   sum_N = sum_(N + M) - sum_(m in M) (P_m t_m' + y_m P_m'),
//   y_m = sum_(q in N) cov(m, q) P_q,   t_m = y_m + sum_(q in M) cov(m, q) P_q.
template <int kTerms>
class MissingPoints {
 public:
  MissingPoints(const GaugeData& data, const GridTile& tile, const Image<double>& present)
      : data_(data), present_(present), reach_(ReachOf(data)) {
    const ImageSize size = data.weight.size();
    const int last_row = std::min(size.height, tile.row + tile.rows + data.half);
    const int last_column = std::min(size.width, tile.column + tile.columns + data.half);
    for (int r = std::max(0, tile.row - data.half); r < last_row; ++r) {
      for (int c = std::max(0, tile.column - data.half); c < last_column; ++c) {
        if (data.weight(r, c) > 0 && !(present(r, c) > 0)) points_.push_back({r, c, {}});
      }
    }
    for (Point& point : points_) {
      for (int dr = -reach_; dr <= reach_; ++dr) {
        for (int dc = -reach_; dc <= reach_; ++dc)
          point.covariances.push_back(Eigen::Map<const Eigen::Vector4d>(
              PairCovariance(data, point.row, point.column, dr, dc).data()));
      }
    }
  }

  // Of the gauge centred at (row, column): whether it has lost points.
  bool Count(int row, int column, GaugeFit& fit) const {
    const int before = fit.points;
    ForEachOf(row, column, [&](const Point& point) {
      const int x = point.column - column, y = point.row - row;
      --fit.points;
      if (x < 0 && y <= 0) --fit.quarter_points[0];
      if (x >= 0 && y < 0) --fit.quarter_points[1];
      if (x > 0 && y >= 0) --fit.quarter_points[2];
      if (x <= 0 && y > 0) --fit.quarter_points[3];
    });
    return fit.points < before;
  }

  void TakeOut(int row, int column, GaugeSums<kTerms>& sums) const {
    ForEachOf(row, column, [&](const Point& point) { TakeOut(point, row, column, sums); });
  }

 private:
  using Terms = Eigen::Matrix<double, kTerms, 1>;
  using PairTerms = Eigen::Matrix<double, kTerms, 4>;  // by uu, uv, vu, vv
  struct Point {
    int row, column;
    std::vector<Eigen::Vector4d> covariances;  // with the points around, row by row
  };

  // Those in the window of a gauge.
  template <typename Visit>
  void ForEachOf(int row, int column, const Visit& visit) const {
    for (const Point& point : points_) {
      if (std::abs(point.column - column) <= data_.half && std::abs(point.row - row) <= data_.half)
        visit(point);
    }
  }

  Terms TermsAt(int dx, int dy) const {
    const double x = static_cast<double>(dx) / data_.half, y = static_cast<double>(dy) / data_.half;
    Eigen::Matrix<double, 10, 1> P;
    P << 1, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y;
    return P.head<kTerms>();
  }

  void TakeOut(const Point& point, int row, int column, GaugeSums<kTerms>& sums) const {
    const int h = data_.half, side = 2 * reach_ + 1;
    const ImageSize size = data_.weight.size();
    const int first_row = std::max({0, row - h, point.row - reach_});
    const int last_row = std::min({size.height - 1, row + h, point.row + reach_});
    const int first_column = std::max({0, column - h, point.column - reach_});
    const int last_column = std::min({size.width - 1, column + h, point.column + reach_});
    PairTerms left = PairTerms::Zero(), missing = PairTerms::Zero();
    for (int r = first_row; r <= last_row; ++r) {
      for (int c = first_column; c <= last_column; ++c) {
        const int at = (r - point.row + reach_) * side + c - point.column + reach_;
        PairTerms& sum = present_(r, c) > 0 ? left : missing;
        sum.noalias() += TermsAt(c - column, r - row) *
                         point.covariances[static_cast<std::size_t>(at)].transpose();
      }
    }
    const PairTerms all = left + missing;
    const Terms P = TermsAt(point.column - column, point.row - row);
    sums.normal -= data_.weight(point.row, point.column) * P * P.transpose();
    sums.pairs[kUu] -= P * all.col(0).transpose() + left.col(0) * P.transpose();
    sums.pairs[kUv] -= P * all.col(1).transpose() + left.col(2) * P.transpose();
    sums.pairs[kVv] -= P * all.col(3).transpose() + left.col(3) * P.transpose();
  }

  const GaugeData& data_;
  const Image<double>& present_;
  const int reach_;
  std::vector<Point> points_;
};

template <int kTerms>
std::vector<GaugeFit> WithoutMissing(const GaugeData& data, const TileGauges& gauges,
                                     const std::vector<GaugeSums<kTerms>>& sums,
                                     const Image<double>& present, int min_points) {
  const MissingPoints<kTerms> missing(data, gauges.tile, present);
  std::vector<GaugeFit> fits = gauges.fits;
  for (std::size_t cell = 0; cell < fits.size(); ++cell) {
    const int r = gauges.tile.RowOf(cell), c = gauges.tile.ColumnOf(cell);
    if (!missing.Count(r, c, fits[cell])) continue;
    fits[cell].solved =
        fits[cell].solved && present(r, c) > 0 && fits[cell].points >= std::max(min_points, kTerms);
    GaugeSums<kTerms> left = sums[cell];
    if (fits[cell].solved) missing.TakeOut(r, c, left);
    Solve(data, left, fits[cell]);
  }
  return fits;
}

}  // namespace

GaugeData::GaugeData(const NeighbourCorrelation& neighbours,
                     const Image<Eigen::Vector3f>& covariances_px2, Image<double> weights,
                     int grid_step_px, int half_window, int polynomial_order)
    : correlation(neighbours),
      cov_px2(covariances_px2),
      weight(std::move(weights)),
      sigma_px(weight.size(), Eigen::Vector2d::Zero()),
      step_px(grid_step_px),
      half(half_window),
      order(polynomial_order) {
  for (std::size_t i = 0; i < sigma_px.pixel_count(); ++i) {
    const Eigen::Vector3d cov = cov_px2.data()[i].cast<double>();
    sigma_px.data()[i] = {std::sqrt(cov[0]), std::sqrt(cov[2])};
  }
}

GaugeRule::GaugeRule(int window_points, double min_share, double min_quarter_share)
    : min_points(static_cast<int>(std::ceil(min_share * window_points * window_points))) {
  const int half = window_points / 2;
  min_quarter_points = min_quarter_share * (half * (half + 1));
}

bool GaugeRule::IsMetBy(const GaugeFit& fit) const {
  const auto& quarters = fit.quarter_points;
  return fit.solved && *std::min_element(quarters.begin(), quarters.end()) >= min_quarter_points;
}

double WeightOf(const Eigen::Vector3f& cov_px2, GaugeWeights weights) {
  if (weights == GaugeWeights::kEqual) return 1;
  const double mean_px2 = 0.5 * (static_cast<double>(cov_px2[0]) + static_cast<double>(cov_px2[2]));
  return mean_px2 > 0 ? 1 / mean_px2 : 0;
}

void CheckGauge(int window_points, int min_window_points, int order, double min_share,
                double min_quarter_share) {
  if (window_points < min_window_points || window_points > 255 || window_points % 2 == 0)
    throw UsageError(fmt::format(
        "the window of a strain gauge must be odd and between {} and 255 points, not {}",
        min_window_points, window_points));
  if (order < 1 || order > 3)
    throw UsageError(fmt::format("the order of a strain gauge must be 1, 2 or 3, not {}", order));
  if (order == 3 && window_points == 3)
    throw UsageError("a strain gauge of order 3 needs a window of 5 points or more, not 3");
  if (!(min_share > 0 && min_share <= 1))
    throw UsageError(fmt::format("min_share must be above 0 and at most 1, not {}", min_share));
  if (!(min_quarter_share >= 0 && min_quarter_share <= 1))
    throw UsageError(
        fmt::format("min_quarter_share must be between 0 and 1, not {}", min_quarter_share));
}

TileGauges FitGauges(const GaugeData& data, const GridTile& tile, int min_points) {
  return data.order == 1   ? TileFit<3>(data, tile, min_points).Run()
         : data.order == 2 ? TileFit<6>(data, tile, min_points).Run()
                           : TileFit<10>(data, tile, min_points).Run();
}

std::vector<GaugeFit> FitsWithoutMissing(const GaugeData& data, const TileGauges& gauges,
                                         const Image<double>& present, int min_points) {
  return std::visit(
      [&](const auto& sums) { return WithoutMissing(data, gauges, sums, present, min_points); },
      gauges.sums);
}

std::vector<GridTile> TilesOf(ImageSize grid) {
  std::vector<GridTile> tiles;
  for (int row = 0; row < grid.height; row += kTileRows) {
    for (int column = 0; column < grid.width; column += kTileColumns)
      tiles.push_back({row, column, std::min(kTileRows, grid.height - row),
                       std::min(kTileColumns, grid.width - column)});
  }
  return tiles;
}

}  // namespace plumbline::internal
