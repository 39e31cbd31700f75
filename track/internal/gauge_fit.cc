#include "track/internal/gauge_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace plumbline::internal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Fills padded tiles, one a component, from the points of the field that they cover.
template <std::size_t kTiles, typename Value>
void Fill(const GridTile& tile, ImageSize field, const Value& value,
          std::array<PaddedTile, kTiles>& out) {
  const int half = out[0].half();
  const int first = std::max(0, half - tile.column);
  const int last = std::min(out[0].columns(), field.width - tile.column + half);
  for (PaddedTile& component : out) component.Clear();
  for (int r = 0; r < out[0].rows(); ++r) {
    const int row = tile.row - half + r;
    if (row < 0 || row >= field.height) continue;
    for (int c = first; c < last; ++c) {
      const auto values = value(row, tile.column - half + c);
      for (std::size_t i = 0; i < kTiles; ++i) out[i].row(r)[c] = values[i];
    }
  }
}

// The fits of one tile by a polynomial of kTerms terms (3: linear, 6: quadratic), whose coordinates
// are in units of the half window.
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
        normal_(tile.cells(), Normal::Zero()),
        rhs_(tile.cells(), Rhs::Zero()) {
    for (auto& pairs : pairs_) pairs.assign(tile.cells(), Normal::Zero());
  }

  std::vector<GaugeFit> Run() {
    Count();
    SumNormalEquations();
    const int reach = std::min(data_.correlation.reach(), 2 * data_.half);
    for (int dr = 0; dr <= reach; ++dr) {
      for (int dc = dr == 0 ? 0 : -reach; dc <= reach; ++dc) AddPairs(dr, dc);
    }
    for (std::size_t cell = 0; cell < fits_.size(); ++cell) Solve(cell);
    return std::move(fits_);
  }

 private:
  using Normal = Eigen::Matrix<double, kTerms, kTerms>;
  using Rhs = Eigen::Matrix<double, kTerms, 2>;
  enum Block { kUu, kUv, kVv };
  static constexpr int kOrder = kTerms == 3 ? 1 : 2;

  void Count();
  void SumNormalEquations();
  void AddPairs(int dr, int dc);
  void FillCovariances(int dr, int dc);
  void AddBlock(Block block, const Normal& shift, bool direct, bool mirrored);
  void Solve(std::size_t cell);
  Normal Outer(std::size_t cell) const;

  const GaugeData& data_;
  const GridTile tile_;
  const int min_points_;
  // By uu, uv, vu, vv.
  std::array<PaddedTile, 4> covariances_;
  std::array<PaddedTile, 1> values_;
  WindowMoments moments_;
  std::vector<GaugeFit> fits_;
  std::vector<Normal> normal_;                // sum w P P'
  std::vector<Rhs> rhs_;                      // sum w P d'
  std::array<std::vector<Normal>, 3> pairs_;  // sum w w P P' cov, by block
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
    const int r = tile_.row + static_cast<int>(cell) / tile_.columns;
    const int c = tile_.column + static_cast<int>(cell) % tile_.columns;
    fits_[cell].solved =
        data_.weight(r, c) > 0 && fits_[cell].points >= std::max(min_points_, kTerms);
    fits_[cell].gradient.setConstant(kNan);
    fits_[cell].cov_gradient.setConstant(kNan);
  }
}

// sum v P P' from the moments of v.
template <int kTerms>
typename TileFit<kTerms>::Normal TileFit<kTerms>::Outer(std::size_t cell) const {
  constexpr std::array<int, 6> kX = {0, 1, 0, 2, 1, 0}, kY = {0, 0, 1, 0, 1, 2};
  Normal out;
  for (std::size_t i = 0; i < kTerms; ++i) {
    for (std::size_t j = 0; j < kTerms; ++j)
      out(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) =
          moments_(MomentIndex(kX[i] + kX[j], kY[i] + kY[j]), cell);
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
  for (std::size_t cell = 0; cell < fits_.size(); ++cell) normal_[cell] = Outer(cell);
  for (int component = 0; component < 2; ++component) {
    const auto weighted = [&](int r, int c) {
      const double w = data_.weight(r, c);
      return std::array{w > 0 ? w * data_.field.displacement_px(r, c)[component] : 0.0};
    };
    Fill(tile_, size, weighted, values_);
    moments_.Compute(values_[0], all, all, kOrder);
    for (std::size_t cell = 0; cell < fits_.size(); ++cell) {
      for (int i = 0; i < kTerms; ++i) rhs_[cell](i, component) = moments_(i, cell);
    }
  }
}

// All pairs of points p and q = p + (dr, dc), and the same pairs named the other way round.
template <int kTerms>
void TileFit<kTerms>::AddPairs(int dr, int dc) {
  const int h = data_.half;
  const bool same = dr == 0 && dc == 0;
  // Both points inside the window.
  const OffsetRange x{std::max(-h, -h - dc), std::min(h, h - dc)}, y{-h, h - dr};
  // P(x_q) = shift P(x_p)
  const double sx = static_cast<double>(dc) / h, sy = static_cast<double>(dr) / h;
  Eigen::Matrix<double, 6, 6> shift;
  shift << 1, 0, 0, 0, 0, 0,        //
      sx, 1, 0, 0, 0, 0,            //
      sy, 0, 1, 0, 0, 0,            //
      sx * sx, 2 * sx, 0, 1, 0, 0,  //
      sx * sy, sy, sx, 0, 1, 0,     //
      sy * sy, 0, 2 * sy, 0, 0, 1;
  FillCovariances(dr, dc);
  const auto add = [&](int component, Block block, bool direct, bool mirrored) {
    moments_.Compute(covariances_[static_cast<std::size_t>(component)], x, y, 2 * kOrder);
    AddBlock(block, shift.topLeftCorner<kTerms, kTerms>(), direct, mirrored);
  };
  add(0, kUu, true, !same);
  add(1, kUv, true, false);
  if (!same) add(2, kUv, false, true);
  add(3, kVv, true, !same);
}

// w_p w_q cov(d_p, d_q) for q = p + (dr, dc), at p.
template <int kTerms>
void TileFit<kTerms>::FillCovariances(int dr, int dc) {
  const ImageSize size = data_.weight.size();
  Fill(
      tile_, size,
      [&](int r, int c) -> std::array<double, 4> {
        const int to_r = r + dr, to_c = c + dc;
        if (to_r >= size.height || to_c < 0 || to_c >= size.width) return {};
        const double weight = data_.weight(r, c) * data_.weight(to_r, to_c);
        if (!(weight > 0)) return {};
        if (dr == 0 && dc == 0) {
          const Eigen::Vector3d own =
              data_.field.cov_displacement_px2(r, c).template cast<double>();
          return {weight * own[0], weight * own[1], weight * own[1], weight * own[2]};
        }
        const Eigen::Matrix2f R = data_.correlation.Between(r, c, dr, dc);
        const Eigen::Vector2d& p = data_.sigma_px(r, c);
        const Eigen::Vector2d& q = data_.sigma_px(to_r, to_c);
        return {weight * p[0] * R(0, 0) * q[0], weight * p[0] * R(0, 1) * q[1],
                weight * p[1] * R(1, 0) * q[0], weight * p[1] * R(1, 1) * q[1]};
      },
      covariances_);
}

template <int kTerms>
void TileFit<kTerms>::AddBlock(Block block, const Normal& shift, bool direct, bool mirrored) {
  for (std::size_t cell = 0; cell < fits_.size(); ++cell) {
    if (!fits_[cell].solved) continue;
    const Normal sum = Outer(cell) * shift.transpose();
    if (direct) pairs_[block][cell] += sum;
    if (mirrored) pairs_[block][cell] += sum.transpose();
  }
}

template <int kTerms>
void TileFit<kTerms>::Solve(std::size_t cell) {
  constexpr double kSmallestPivot = 1e-9;
  GaugeFit& fit = fits_[cell];
  if (!fit.solved) return;
  const Eigen::LDLT<Normal> solver(normal_[cell]);
  const auto pivots = solver.vectorD();
  fit.solved = pivots.minCoeff() > kSmallestPivot * pivots.maxCoeff();
  if (!fit.solved) return;
  const double per_px = 1.0 / (data_.half * data_.field.step_px);
  const Eigen::Matrix<double, kTerms, 2> rows =
      per_px * solver.solve(Normal::Identity()).template middleCols<2>(1);
  fit.gradient = (rows.transpose() * rhs_[cell]).transpose();
  const auto block = [&](Block which) -> Eigen::Matrix2d {
    return rows.transpose() * pairs_[which][cell] * rows;
  };
  fit.cov_gradient.topLeftCorner<2, 2>() = block(kUu);
  fit.cov_gradient.bottomRightCorner<2, 2>() = block(kVv);
  fit.cov_gradient.topRightCorner<2, 2>() = block(kUv);
  fit.cov_gradient.bottomLeftCorner<2, 2>() = fit.cov_gradient.topRightCorner<2, 2>().transpose();
}

}  // namespace

std::vector<GaugeFit> FitGauges(const GaugeData& data, const GridTile& tile, int min_points) {
  return data.order == 1 ? TileFit<3>(data, tile, min_points).Run()
                         : TileFit<6>(data, tile, min_points).Run();
}

}  // namespace plumbline::internal
