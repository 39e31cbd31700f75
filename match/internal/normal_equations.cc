#include "match/internal/normal_equations.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace plumbline::internal {
namespace {

constexpr int kPowerX[6] = {0, 1, 0, 2, 1, 0};
constexpr int kPowerY[6] = {0, 0, 1, 0, 1, 2};

// Place of m_a m_b among the monomials of subset_sums.h.
constexpr int ProductPlace(int a, int b) {
  const int degree = kPowerX[a] + kPowerY[a] + kPowerX[b] + kPowerY[b];
  return degree * (degree + 1) / 2 + kPowerY[a] + kPowerY[b];
}

ShapeVector Stacked(const double* x, const double* y, int terms) {
  ShapeVector v(2 * terms);
  for (int k = 0; k < terms; ++k) {
    v[k] = x[k];
    v[terms + k] = y[k];
  }
  return v;
}

}  // namespace

NormalEquations::NormalEquations(int order, int pixel_count, const ReferenceSums& reference,
                                 const ProductSums& products)
    : order_(order), terms_(kShapeTerms[order]), count_(pixel_count) {
  mean_ = reference.f / count_;
  energy_ = reference.ff - count_ * mean_ * mean_;
  if (!(energy_ > 0)) return;
  const ShapeVector sum = Stacked(reference.gradient_x, reference.gradient_y, terms_);
  mean_gradient_ = sum / count_;
  slope_ =
      (Stacked(reference.f_gradient_x, reference.f_gradient_y, terms_) - mean_ * sum) / energy_;
  full_ = Assemble(products);
  information_ = full_ - count_ * mean_gradient_ * mean_gradient_.transpose() -
                 energy_ * slope_ * slope_.transpose();
  if (!(information_.diagonal().minCoeff() > 0) || !information_.allFinite()) return;
  scale_ = information_.diagonal().cwiseSqrt().cwiseInverse();
  const ShapeMatrix scaled = scale_.asDiagonal() * information_ * scale_.asDiagonal();
  const Eigen::LLT<ShapeMatrix> llt(scaled);
  if (llt.info() != Eigen::Success) return;
  factor_ = llt.matrixL();
  // The sums are of floats: what lies below their rounding is no information.
  solvable_ = factor_.diagonal().minCoeff() > 1e-3;
}

ShapeMatrix NormalEquations::Assemble(const ProductSums& products) const {
  ShapeMatrix matrix(2 * terms_, 2 * terms_);
  for (int a = 0; a < terms_; ++a) {
    for (int b = 0; b < terms_; ++b) {
      const int at = ProductPlace(a, b);
      matrix(a, b) = products.xx[at];
      matrix(a, terms_ + b) = products.xy[at];
      matrix(terms_ + a, b) = products.xy[at];
      matrix(terms_ + a, terms_ + b) = products.yy[at];
    }
  }
  return matrix;
}

NormalEquations::Fit NormalEquations::Evaluate(const TargetSums& target) const {
  Fit fit;
  const double with_f = target.fg - mean_ * target.g;
  const double energy = target.gg - target.g * target.g / count_;
  fit.gain = with_f / energy_;
  fit.mean = target.g / count_;
  fit.zncc = energy > 0 ? with_f / std::sqrt(energy * energy_) : 0;
  fit.gradient = Stacked(target.gradient_x, target.gradient_y, terms_) - mean_gradient_ * target.g -
                 slope_ * with_f;
  fit.residual = std::max(0.0, energy - with_f * fit.gain);
  return fit;
}

bool NormalEquations::Step(const Fit& fit, double lambda, SubsetWarp& step) const {
  ShapeVector delta = scale_.cwiseProduct(fit.gradient);
  if (lambda > 0) {
    ShapeMatrix damped = factor_ * factor_.transpose();
    damped.diagonal() *= 1 + lambda;
    delta = damped.llt().solve(delta);
  } else {
    factor_.triangularView<Eigen::Lower>().solveInPlace(delta);
    factor_.triangularView<Eigen::Lower>().transpose().solveInPlace(delta);
  }
  delta = scale_.cwiseProduct(delta).eval();
  const double gain = fit.gain - slope_.dot(delta);
  if (!(gain > 0) || !delta.allFinite()) return false;
  step = SubsetWarp();
  for (int k = 0; k < terms_; ++k) {
    step.c(0, k) = delta[k] / gain;
    step.c(1, k) = delta[terms_ + k] / gain;
  }
  return true;
}

ShapeMatrix NormalEquations::CovariancePerVariance(const ProductSums* noise) const {
  // In the scaled unknowns: with H~ = L L', L^-1 M~ L^-T first.
  ShapeMatrix inverse = ShapeMatrix::Identity(2 * terms_, 2 * terms_);
  factor_.triangularView<Eigen::Lower>().solveInPlace(inverse);
  ShapeMatrix covariance;
  if (noise == nullptr) {
    covariance = inverse.transpose() * inverse;
  } else {
    // Gain and offset take out what is smooth over the subset, which the filter leaves as it is.
    const ShapeMatrix of_noise = Assemble(*noise) - (full_ - information_);
    const ShapeMatrix scaled = scale_.asDiagonal() * of_noise * scale_.asDiagonal();
    const ShapeMatrix middle = inverse * scaled * inverse.transpose();
    covariance = inverse.transpose() * middle * inverse;
  }
  return scale_.asDiagonal() * covariance * scale_.asDiagonal();
}

double NormalEquations::MeanSquareShift(const SubsetWarp& step, double radius_px) {
  const double r2 = radius_px * radius_px;
  // Means over the square: x^2 -> r^2 / 3, x^4 -> r^4 / 5, x^2 y^2 -> r^4 / 9.
  double mean = 0;
  for (int i = 0; i < 2; ++i) {
    const auto c = step.c.row(i);
    mean += c[0] * c[0] + (c[1] * c[1] + c[2] * c[2] + 2 * c[0] * (c[3] + c[5])) * r2 / 3 +
            (c[3] * c[3] + c[5] * c[5]) * r2 * r2 / 5 +
            (c[4] * c[4] + 2 * c[3] * c[5]) * r2 * r2 / 9;
  }
  return mean;
}

}  // namespace plumbline::internal
