#pragma once

#include <Eigen/Core>

#include "match/internal/subset_sums.h"
#include "match/subset_warp.h"

namespace plumbline::internal {

// Unknowns of a shape function: its terms along x, then those along y. At most 12.
using ShapeVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 12, 1>;
using ShapeMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 12, 12>;

// The least-squares problem of one subset, g = gain (f + J delta) + offset: everything that does
// not depend on the deformed image.
//
// J~ is J with its projections on 1 and f - mean(f) taken out, so that gain and offset are free:
//   J~ = J - mean(J) - slope (f - mean(f)),   H~ = sum J~ J~'.
class NormalEquations {
 public:
  NormalEquations() = default;  // not solvable
  NormalEquations(int order, int pixel_count, const ReferenceSums& reference,
                  const ProductSums& products);

  // False where the subset says nothing about some unknown.
  bool solvable() const { return solvable_; }

  // What the deformed image says.
  struct Fit {
    double zncc = 0;
    double gain = 0;
    double mean = 0;       // of g
    double energy = 0;     // sum of squares of g - mean
    double residual = 0;   // what the fit leaves of it
    ShapeVector gradient;  // sum J~ g
  };
  Fit Evaluate(const TargetSums& target) const;

  // The step to take, damped by lambda times the diagonal of H~. False where the gain would not be
  // positive, or next to nothing.
  bool Step(const Fit& fit, double lambda, SubsetWarp& step) const;

  // H~^-1 M~ H~^-1 per variance of a raw pixel, of the displacement and its gradient: u, du/dx,
  // du/dy, v, dv/dx, dv/dy (order 0: u, v). `noise` are the products of the gradients filtered once
  // more, or null where there is no filter.
  using Covariance = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 6, 6>;
  Covariance CovariancePerVariance(const ProductSums* noise) const;

  // At most how much of an undamped step is left to go after it, as a share of it: the reference's
  // noise counts as texture in the information, so that steps are too short by its share of that.
  // What the fit leaves tells the noise; a derivative lets pass pi^2 / 3 times as much of it at
  // most (the ideal interpolation's), and half of it is the reference's.
  double LeftAfterStep(const Fit& fit) const;

  // The fit at the end of an undamped step, as the linear problem foresees it: what has changed is
  // zncc and residual.
  Fit Foreseen(const Fit& fit) const;

  // Mean square shift of the subset's pixels by a step, for squares of this radius.
  static double MeanSquareShift(const SubsetWarp& step, double radius_px);

  int unknowns() const { return 2 * terms_; }
  double mean() const { return mean_; }  // of f

 private:
  ShapeMatrix Assemble(const ProductSums& products) const;
  ShapeMatrix OfGainAndOffset() const;

  int order_ = 0, terms_ = 1;
  double count_ = 0;
  double mean_ = 0, energy_ = 0;  // of f
  ShapeVector mean_gradient_, slope_;
  ShapeVector scale_;   // 1 / sqrt of the information's diagonal
  ShapeMatrix factor_;  // Cholesky factor of the scaled information, lower
  bool solvable_ = false;
};

}  // namespace plumbline::internal
