#include "match/neighbour_correlation.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <utility>

#include "calib/error.h"

namespace plumbline {
namespace {

int TermsOf(int order) { return (order + 1) * (order + 2) / 2; }

// The monomials of the shape function (columns) at the pixels of a subset, row by row, in units of
// its half width, so that normal matrices are well scaled in single precision; rows of zeros for
// the corners outside a circle.
Eigen::MatrixXf Monomials(const SubsetGrid& subsets) {
  const int side = subsets.subset_px, radius = side / 2;
  const float scale = 1.0F / static_cast<float>(std::max(1, radius));
  Eigen::MatrixXf out = Eigen::MatrixXf::Zero(side * side, TermsOf(subsets.order));
  for (int dy = -radius; dy <= radius; ++dy) {
    for (int dx = -radius; dx <= radius; ++dx) {
      if (!subsets.Contains(dx, dy)) continue;
      const float x = scale * static_cast<float>(dx), y = scale * static_cast<float>(dy);
      const Eigen::Matrix<float, 1, 6> terms(1, x, y, x * x, x * y, y * y);
      out.row((dy + radius) * side + dx + radius) = terms.head(out.cols());
    }
  }
  return out;
}

// The rows `wanted` of (J'J)^-1, as columns; empty where they cannot be told from single precision.
Eigen::MatrixXd RowsOfInverse(const Eigen::MatrixXf& J, const std::vector<int>& wanted) {
  constexpr double kSmallestPivot = 1e-5;  // of a matrix with unit diagonal
  const Eigen::MatrixXd H = (J.transpose() * J).cast<double>();
  if (!(H.diagonal().minCoeff() > 0) || !H.allFinite()) return {};
  const Eigen::VectorXd scale = H.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::MatrixXd> solver(scale.asDiagonal() * H * scale.asDiagonal());
  if (!(solver.vectorD().minCoeff() > kSmallestPivot)) return {};
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(H.rows(), static_cast<Eigen::Index>(wanted.size()));
  for (std::size_t i = 0; i < wanted.size(); ++i)
    rhs(wanted[i], static_cast<Eigen::Index>(i)) = scale[wanted[i]];
  return scale.asDiagonal() * solver.solve(rhs);
}

// The sum over the pixels that two subsets d apart share of a(k) b(k - d), for each pair of columns
// of a and b.
template <int kColumns>
Eigen::Matrix<float, kColumns, kColumns> SharedProducts(
    const Eigen::Ref<const Eigen::Matrix<float, Eigen::Dynamic, kColumns>>& a,
    const Eigen::Ref<const Eigen::Matrix<float, Eigen::Dynamic, kColumns>>& b, int side, int dx_px,
    int dy_px) {
  Eigen::Matrix<float, kColumns, kColumns> sum;
  sum.setZero();
  const int length = side - std::abs(dx_px);
  if (length <= 0) return sum;
  const int first_x = std::max(0, dx_px);
  for (int y = std::max(0, dy_px); y < side + std::min(0, dy_px); ++y) {
    const Eigen::Index at_a = y * side + first_x;
    const Eigen::Index at_b = (y - dy_px) * side + first_x - dx_px;
    for (int i = 0; i < kColumns; ++i) {
      for (int j = 0; j < kColumns; ++j)
        sum(i, j) += a.col(i).segment(at_a, length).dot(b.col(j).segment(at_b, length));
    }
  }
  return sum;
}

}  // namespace

// Fills the table row of nodes by row of nodes, keeping the weights of the subsets that the row's
// offsets reach.
class NeighbourCorrelationBuilder {
 public:
  NeighbourCorrelationBuilder(const SubsetGrid& subsets, const ReferenceTexture& texture)
      : subsets_(subsets), texture_(texture), monomials_(Monomials(subsets)) {}

  static NeighbourCorrelation OfOverlap(const SubsetGrid& subsets);
  NeighbourCorrelation Build();

 private:
  using Patch = Eigen::Matrix<float, Eigen::Dynamic, 2>;  // weights of u and v, pixel by pixel
  struct Scratch {
    Eigen::MatrixXf J;
    Eigen::ArrayXf valid, grey, gx, gy, sigma;
  };

  void LayOut();
  bool Gather(const Eigen::Vector2i& centre_px, Scratch& scratch) const;
  void WeightsAt(const Eigen::Vector2i& centre_px, Scratch& scratch, Patch& weights) const;
  void FillBandRow(int lattice_row);
  void FillNode(int node_row, int node_column);

  Patch& Weights(int lattice_row, int lattice_column) {
    const int ring = lattice_row % (out_.offset_reach_ + 1);
    return band_[static_cast<std::size_t>(ring * lattice_.width + lattice_column + margin_)];
  }
  bool InLattice(int lattice_row, int lattice_column) const {
    return lattice_row < lattice_.height && lattice_column >= -margin_ &&
           lattice_column < lattice_.width - margin_;
  }

  const SubsetGrid& subsets_;
  const ReferenceTexture& texture_;
  const Eigen::MatrixXf monomials_;
  NeighbourCorrelation out_;
  int nodes_every_ = 1;  // lattice points
  int margin_ = 0;       // lattice points outside the grid: left, right and below
  ImageSize lattice_;    // margins included
  std::vector<Patch> band_;
};

NeighbourCorrelation NeighbourCorrelationBuilder::OfOverlap(const SubsetGrid& subsets) {
  const Eigen::MatrixXf P = Monomials(subsets);
  const Eigen::MatrixXd row = RowsOfInverse(P, {0});
  const Eigen::VectorXf kernel = row.size() == 0 ? Eigen::VectorXf(P.col(0))  // of too few pixels
                                                 : Eigen::VectorXf(P * row.cast<float>());
  NeighbourCorrelation out;
  out.reach_ = (subsets.subset_px - 1) / subsets.step_px;
  for (int dy = 0; dy <= out.reach_; ++dy) {
    for (int dx = 0; dx <= out.reach_; ++dx) {
      out.overlap_.push_back(SharedProducts<1>(kernel, kernel, subsets.subset_px,
                                               dx * subsets.step_px, dy * subsets.step_px)(0) /
                             kernel.squaredNorm());
    }
  }
  return out;
}

void NeighbourCorrelationBuilder::LayOut() {
  constexpr int kLeastNodeDistancePx = 4;
  const double quarter_px = 0.25 * subsets_.subset_px;
  out_.offset_step_ = std::max(1, static_cast<int>(std::lround(quarter_px / subsets_.step_px)));
  const int spacing_px = out_.offset_step_ * subsets_.step_px;
  out_.offset_reach_ = (subsets_.subset_px - 1) / spacing_px;
  nodes_every_ = (kLeastNodeDistancePx + spacing_px - 1) / spacing_px;
  out_.node_step_ = nodes_every_ * out_.offset_step_;
  const auto nodes = [&](int points) { return (points - 1) / out_.node_step_ + 1; };
  out_.nodes_ = {nodes(subsets_.grid.width), nodes(subsets_.grid.height)};
  // The nearest node may lie up to half a node's distance from the point: what it needs for the
  // same offset then lies as far outside the grid.
  margin_ = out_.node_step_ > 1 ? nodes_every_ / 2 + 1 : 0;
  const auto lattice = [&](int points) { return (points - 1) / out_.offset_step_ + 1; };
  lattice_ = {lattice(subsets_.grid.width) + 2 * margin_, lattice(subsets_.grid.height) + margin_};
  const std::size_t offsets =
      static_cast<std::size_t>((out_.offset_reach_ + 1) * (2 * out_.offset_reach_ + 1));
  out_.table_.assign(static_cast<std::size_t>(out_.nodes_.width) *
                         static_cast<std::size_t>(out_.nodes_.height) * offsets,
                     Eigen::Matrix2f::Zero());
  band_.resize(static_cast<std::size_t>(out_.offset_reach_ + 1) *
               static_cast<std::size_t>(lattice_.width));
}

// The subset's pixels, zero where there is none or it is not to be used. False where the centre is
// outside the image.
bool NeighbourCorrelationBuilder::Gather(const Eigen::Vector2i& centre_px, Scratch& scratch) const {
  const Image<float>& grey = *texture_.grey;
  const int side = subsets_.subset_px;
  if (centre_px.minCoeff() < 0 || centre_px.x() >= grey.width() || centre_px.y() >= grey.height())
    return false;
  const int left = centre_px.x() - side / 2, top = centre_px.y() - side / 2;
  const int first_x = std::max(0, -left), length = std::min(side, grey.width() - left) - first_x;
  for (Eigen::ArrayXf* array :
       {&scratch.valid, &scratch.grey, &scratch.gx, &scratch.gy, &scratch.sigma})
    array->setZero(side * side);
  for (int y = std::max(0, -top); y < std::min(side, grey.height() - top); ++y) {
    const Eigen::Index to = y * side + first_x;
    const auto copy = [&](const Image<float>& image, Eigen::ArrayXf& array) {
      array.segment(to, length) =
          Eigen::Map<const Eigen::ArrayXf>(image.row(top + y) + left + first_x, length);
    };
    copy(grey, scratch.grey);
    copy(*texture_.gradient_x, scratch.gx);
    copy(*texture_.gradient_y, scratch.gy);
    if (texture_.variance_grey2 != nullptr) copy(*texture_.variance_grey2, scratch.sigma);
    scratch.valid.segment(to, length) = monomials_.col(0).segment(to, length).array();
    if (texture_.mask == nullptr) continue;
    const std::uint8_t* mask = texture_.mask->row(top + y) + left + first_x;
    for (int x = 0; x < length; ++x) {
      if (mask[x] == 0) scratch.valid[to + x] = 0;
    }
  }
  return true;
}

// Weights times the noise's sigma, scaled to unit norm: their shared products are correlations.
// Empty where the subset cannot be solved.
void NeighbourCorrelationBuilder::WeightsAt(const Eigen::Vector2i& centre_px, Scratch& scratch,
                                            Patch& weights) const {
  weights.resize(0, 2);
  if (!Gather(centre_px, scratch)) return;
  const Eigen::Index terms = monomials_.cols(), pixels = monomials_.rows();
  const float count = scratch.valid.sum();
  if (count < static_cast<float>(2 * terms + 3)) return;
  // Masked pixels may hold anything, NaN too.
  const auto used = scratch.valid > 0;
  const float mean = used.select(scratch.grey, 0).sum() / count;
  scratch.gx = used.select(scratch.gx, 0);
  scratch.gy = used.select(scratch.gy, 0);
  Eigen::MatrixXf& J = scratch.J;
  J.resize(pixels, 2 * terms + 2);
  for (Eigen::Index i = 0; i < terms; ++i) {
    J.col(i) = monomials_.col(i).array() * scratch.gx;
    J.col(terms + i) = monomials_.col(i).array() * scratch.gy;
  }
  J.col(2 * terms) = scratch.valid;
  J.col(2 * terms + 1) = used.select(scratch.grey - mean, 0);  // less the mean: well conditioned
  const Eigen::MatrixXd rows = RowsOfInverse(J, {0, static_cast<int>(terms)});
  if (rows.size() == 0) return;
  weights.noalias() = J * rows.cast<float>();
  if (texture_.variance_grey2 != nullptr) {
    scratch.sigma = used.select(scratch.sigma.max(0).sqrt(), 0);
    weights.array().colwise() *= scratch.sigma;
  }
  const Eigen::RowVector2f norm = weights.colwise().norm();
  if (!(norm.minCoeff() > 0) || !norm.allFinite()) {
    weights.resize(0, 2);
    return;
  }
  weights.array().rowwise() /= norm.array();
}

void NeighbourCorrelationBuilder::FillBandRow(int lattice_row) {
  const int spacing_px = out_.offset_step_ * subsets_.step_px;
  tbb::parallel_for(tbb::blocked_range<int>(-margin_, lattice_.width - margin_),
                    [&](const tbb::blocked_range<int>& columns) {
                      Scratch scratch;
                      for (int c = columns.begin(); c != columns.end(); ++c) {
                        const Eigen::Vector2i centre_px =
                            subsets_.first_px + spacing_px * Eigen::Vector2i(c, lattice_row);
                        WeightsAt(centre_px, scratch, Weights(lattice_row, c));
                      }
                    });
}

void NeighbourCorrelationBuilder::FillNode(int node_row, int node_column) {
  const int reach = out_.offset_reach_;
  const int spacing_px = out_.offset_step_ * subsets_.step_px;
  const int row = node_row * nodes_every_, column = node_column * nodes_every_;
  Eigen::Matrix2f* entry = out_.table_.data() + out_.NodeStart(node_row, node_column);
  const Patch& here = Weights(row, column);
  for (int dr = 0; dr <= reach; ++dr) {
    for (int dc = -reach; dc <= reach; ++dc, ++entry) {
      if (here.rows() == 0 || !InLattice(row + dr, column + dc)) continue;
      const Patch& there = Weights(row + dr, column + dc);
      if (there.rows() == 0) continue;
      *entry = SharedProducts<2>(here, there, subsets_.subset_px, dc * spacing_px, dr * spacing_px);
      entry->diagonal().array() -= out_.Overlap(dr * out_.offset_step_, dc * out_.offset_step_);
    }
  }
}

NeighbourCorrelation NeighbourCorrelationBuilder::Build() {
  out_ = OfOverlap(subsets_);
  LayOut();
  int filled = 0;
  for (int node_row = 0; node_row < out_.nodes_.height; ++node_row) {
    const int row = node_row * nodes_every_;
    const int end = std::min(row + out_.offset_reach_ + 1, lattice_.height);
    for (filled = std::max(filled, row); filled < end; ++filled) FillBandRow(filled);
    tbb::parallel_for(0, out_.nodes_.width, [&](int column) { FillNode(node_row, column); });
  }
  return std::move(out_);
}

void SubsetGrid::Check() const {
  if (grid.width < 1 || grid.height < 1)
    throw UsageError(
        fmt::format("a grid of {} x {} points holds none; choose a smaller step or a "
                    "larger region",
                    grid.width, grid.height));
  if (step_px < 1) throw UsageError(fmt::format("step_px must be at least 1, not {}", step_px));
  if (subset_px < 3 || subset_px % 2 == 0)
    throw UsageError(fmt::format("subset_px must be odd and at least 3, not {}", subset_px));
  if (order < 0 || order > 2)
    throw UsageError(
        fmt::format("the order of the shape function must be 0, 1 or 2, not {}", order));
}

NeighbourCorrelation NeighbourCorrelation::OfOverlap(ImageSize grid, int step_px, int subset_px,
                                                     int order, bool circular) {
  const SubsetGrid subsets{grid, {0, 0}, step_px, subset_px, order, circular};
  subsets.Check();
  return NeighbourCorrelationBuilder::OfOverlap(subsets);
}

NeighbourCorrelation NeighbourCorrelation::OfTexture(const SubsetGrid& subsets,
                                                     const ReferenceTexture& texture) {
  subsets.Check();
  if (texture.grey == nullptr || texture.gradient_x == nullptr || texture.gradient_y == nullptr)
    throw InputError(
        "the correlation of neighbouring points needs the grey values and both "
        "gradients of the reference image");
  const ImageSize size = texture.grey->size();
  const auto differs = [&](const auto* image) { return image != nullptr && image->size() != size; };
  if (differs(texture.gradient_x) || differs(texture.gradient_y) ||
      differs(texture.variance_grey2) || differs(texture.mask))
    throw InputError(
        fmt::format("gradients, noise and mask must have the size of the reference image, {} x {}",
                    size.width, size.height));
  return NeighbourCorrelationBuilder(subsets, texture).Build();
}

std::size_t NeighbourCorrelation::NodeStart(int row, int column) const {
  const auto offsets = static_cast<std::size_t>((offset_reach_ + 1) * (2 * offset_reach_ + 1));
  return (static_cast<std::size_t>(row) * static_cast<std::size_t>(nodes_.width) +
          static_cast<std::size_t>(column)) *
         offsets;
}

float NeighbourCorrelation::Overlap(int d_row, int d_column) const {
  const int r = std::abs(d_row), c = std::abs(d_column);
  return r > reach_ || c > reach_ ? 0 : overlap_[static_cast<std::size_t>(r * (reach_ + 1) + c)];
}

Eigen::Matrix2f NeighbourCorrelation::Between(int row, int column, int d_row, int d_column) const {
  if (std::abs(d_row) > reach_ || std::abs(d_column) > reach_) return Eigen::Matrix2f::Zero();
  // One of the two points is asked for both.
  if (d_row < 0 || (d_row == 0 && d_column < 0))
    return Between(row + d_row, column + d_column, -d_row, -d_column).transpose();
  const float overlap = Overlap(d_row, d_column);
  Eigen::Matrix2f R = Eigen::Matrix2f::Identity() * overlap;
  if (table_.empty()) return R;
  const auto nearest = [&](int i, int nodes) {
    return std::clamp((i + node_step_ / 2) / node_step_, 0, nodes - 1);
  };
  const Eigen::Matrix2f* node =
      table_.data() + NodeStart(nearest(row, nodes_.height), nearest(column, nodes_.width));
  // Bilinear between the offsets of the table around d; beyond the table's reach R is zero.
  const int shifted = d_column + offset_reach_ * offset_step_ + offset_step_;  // not negative
  const int r0 = d_row / offset_step_, c0 = shifted / offset_step_ - 1;
  const float unit = 1 / static_cast<float>(offset_step_);
  const float fr = unit * static_cast<float>(d_row % offset_step_);
  const float fc = unit * static_cast<float>(shifted % offset_step_);
  const int width = 2 * offset_reach_ + 1;
  const auto add = [&](int r, int c, float weight) {
    if (weight > 0 && r <= offset_reach_ && c >= 0 && c < width) R += weight * node[r * width + c];
  };
  add(r0, c0, (1 - fr) * (1 - fc));
  add(r0, c0 + 1, (1 - fr) * fc);
  add(r0 + 1, c0, fr * (1 - fc));
  add(r0 + 1, c0 + 1, fr * fc);
  return R;
}

}  // namespace plumbline
