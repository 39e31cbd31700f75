#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// Where the subsets of a field lie, and what is solved for in each.
struct SubsetGrid {
  ImageSize grid;  // columns and rows of POIs
  Eigen::Vector2i first_px{0, 0};
  int step_px = 1;
  int subset_px = 0;      // odd; side of the square or diameter of the circle
  int order = 1;          // of the shape function, 0 to 2
  bool circular = false;  // pixels whose centre is within subset_px / 2 of the POI

  bool Contains(int dx_px, int dy_px) const {
    return !circular || 4 * (dx_px * dx_px + dy_px * dy_px) <= subset_px * subset_px;
  }

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What the weights of a subset's pixels depend on: the reference image and its derivatives at whole
// pixels, as the correlator uses them, all of one size and finite where the mask lets them in.
struct ReferenceTexture {
  const Image<float>* grey = nullptr;
  const Image<float>* gradient_x = nullptr;  // grey a px
  const Image<float>* gradient_y = nullptr;
  const Image<float>* variance_grey2 = nullptr;  // of the noise; null: the same everywhere
  const Image<std::uint8_t>* mask = nullptr;     // 0: pixel not used; null: all are
};

// How far the errors of neighbouring POIs go together, because their subsets share pixels: for two
// points p and q of a field, cov(d_p, d_q) = S_p R S_q with S the diagonal of the displacements'
// sigmas and R(component of p, component of q) the correlation delivered here.
//
// The noise reaches a displacement through the weight of each pixel, w_p(k) = H_p^-1 J_p(k); the
// covariance of two points is the sum over shared pixels of w_p(k) w_q(k)' times the noise's
// variance. It depends on the reference image, the subset and the order only, and is the same
// in all frames. The noise of the deformed image, carried back to the reference, has the same
// weights, so that R holds for both images together.
class NeighbourCorrelation {
 public:
  // Grid steps beyond which points are independent, in either direction.
  int reach() const { return reach_; }

  // R between the point at (row, column) and that at (row + d_row, column + d_column). Zero beyond
  // reach(); at d = 0 the correlation matrix of the point itself. Seen from the other point it is
  // the transposed matrix, to the last bit.
  Eigen::Matrix2f Between(int row, int column, int d_row, int d_column) const;

  // Without an image: as if all gradients were alike and independent. R is then a multiple of
  // the unit matrix that depends on the distance only,
  //   R(d) = sum_x K(x) K(x - d) / sum_x K(x)^2,   K(x) = e1' (sum P P')^-1 P(x),
  // K being the weights of a least-squares polynomial P of the order at the subset's centre; for
  // orders 0 and 1 the shared share of the subsets' area. Throws UsageError from SubsetGrid::Check.
  static NeighbourCorrelation OfOverlap(ImageSize grid, int step_px, int subset_px, int order,
                                        bool circular = false);

  // With the image. Every subset solves for the coefficients of (1, x, y, x^2, x y, y^2) up to the
  // order in u, then in v, and for the offset and gain of the grey values:
  //   J_p(k) = (P(k - p) gx(k), P(k - p) gy(k), 1, f(k)),   H_p = sum_k J_p(k) J_p(k)',
  // pixels outside the image or the mask left out.
  //
  // R is tabulated on a lattice of nodes, about a quarter of a subset (at least 4 px and a step)
  // apart, with offsets on the lattice too; for denser grids the nearest node is taken and what R
  // has beyond OfOverlap() is interpolated bilinearly in the offset. So the table is bounded by the
  // image and not by the number of POIs: about 10 bytes a pixel. Where no subset can be solved, as
  // on blank background, R is OfOverlap()'s. Independent of the number of threads.
  //
  // Throws: UsageError from SubsetGrid::Check(); InputError where the images are missing or of
  //         different size.
  static NeighbourCorrelation OfTexture(const SubsetGrid& subsets, const ReferenceTexture& texture);

 private:
  friend class NeighbourCorrelationBuilder;

  std::size_t NodeStart(int row, int column) const;  // in table_
  float Overlap(int d_row, int d_column) const;

  int reach_ = 0;
  std::vector<float> overlap_;  // OfOverlap() by |d_row|, |d_column| up to reach_
  // Of the table; without nodes there is none.
  int offset_step_ = 1;  // in grid steps
  int offset_reach_ = 0;
  int node_step_ = 1;  // in grid steps
  ImageSize nodes_;
  // Per node (offset_reach_ + 1) x (2 offset_reach_ + 1) matrices by d_row >= 0 and d_column: R
  // less what overlap_ holds.
  std::vector<Eigen::Matrix2f> table_;
};

}  // namespace plumbline
