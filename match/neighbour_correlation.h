#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// How far the errors of neighbouring POIs go together, because their subsets share pixels: for two
// points p and q of a field, cov(d_p, d_q) = S_p R S_q with S the diagonal of the displacements'
// sigmas and R(component of p, component of q) the correlation delivered here.
//
// The noise reaches a displacement through the weight of each pixel, w_p(k) = H_p^-1 J_p(k); the
// covariance of two points is the sum over shared pixels of w_p(k) w_q(k)' times the noise's
// variance. It depends on the reference image, the subset and the order only, and is the same
// in all frames.
class NeighbourCorrelation {
 public:
  // Grid steps beyond which points are independent, in either direction.
  int reach() const { return reach_; }

  // R between the point at (row, column) and that at (row + d_row, column + d_column). Zero beyond
  // reach(); at d = 0 the correlation matrix of the point itself.
  Eigen::Matrix2f Between(int row, int column, int d_row, int d_column) const;

  // Without an image: as if all gradients were alike and independent. R is then a multiple of
  // the unit matrix that depends on the distance only; for orders 0 and 1 the shared share of the
  // subsets' area.
  static NeighbourCorrelation OfOverlap(ImageSize grid, int step_px, int subset_px, int order);

 private:
  friend class NeighbourCorrelationBuilder;
  ImageSize grid_;
  int reach_ = 0;
  int thinning_ = 1;  // one node of the table every so many points of the grid
  ImageSize nodes_;   // of the table
  // Per node: (2 reach + 1)^2 matrices, row by row of d_row, d_column. Without nodes: one for all.
  std::vector<Eigen::Matrix2f> table_;
};

}  // namespace plumbline
