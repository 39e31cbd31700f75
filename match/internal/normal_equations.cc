#include "match/internal/normal_equations.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <type_traits>

namespace plumbline::internal {
namespace {

// Below it nothing of the texture is there: what is left of a blank image is rounding.
constexpr double kLeastGain = 1e-4;

constexpr double kNoiseInGradient = std::numbers::pi * std::numbers::pi / 3;

constexpr int kPowerX[6] = {0, 1, 0, 2, 1, 0};
constexpr int kPowerY[6] = {0, 0, 1, 0, 1, 2};

// Place of m_a m_b among the monomials of subset_sums.h.
constexpr int ProductPlace(int a, int b) {
  const int degree = kPowerX[a] + kPowerY[a] + kPowerX[b] + kPowerY[b];
  return degree * (degree + 1) / 2 + kPowerY[a] + kPowerY[b];
}

// Calls visit with the number of unknowns as a compile-time constant, so that Eigen unrolls.
template <typename Visit>
auto WithSize(int unknowns, const Visit& visit) {
  switch (unknowns) {
    case 2:
      return visit(std::integral_constant<int, 2>());
    case 6:
      return visit(std::integral_constant<int, 6>());
    default:
      return visit(std::integral_constant<int, 12>());
  }
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
  const ShapeMatrix information = Assemble(products) - OfGainAndOffset();
  if (!(information.diagonal().minCoeff() > 0) || !information.allFinite()) return;
  // Stripes: what is seen along them is the rounding of the filters.
  const double along_x = information(0, 0);
  const double along_y = information(terms_, terms_);
  if (std::min(along_x, along_y) < 1e-7 * std::max(along_x, along_y)) return;
  scale_ = information.diagonal().cwiseSqrt().cwiseInverse();
  const ShapeMatrix scaled = scale_.asDiagonal() * information * scale_.asDiagonal();
  const bool positive = WithSize(unknowns(), [&](auto size) {
    const Eigen::LLT<Eigen::Matrix<double, size, size>> llt(scaled);
    factor_ = llt.matrixL();
    return llt.info() == Eigen::Success;
  });
  if (!positive) return;
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

// What gain and offset take of the information.
ShapeMatrix NormalEquations::OfGainAndOffset() const {
  return count_ * mean_gradient_ * mean_gradient_.transpose() +
         energy_ * slope_ * slope_.transpose();
}

NormalEquations::Fit NormalEquations::Evaluate(const TargetSums& target) const {
  Fit fit;
  const double with_f = target.fg - mean_ * target.g;
  fit.energy = target.gg - target.g * target.g / count_;
  fit.gain = with_f / energy_;
  fit.mean = target.g / count_;
  fit.zncc = fit.energy > 0 ? with_f / std::sqrt(fit.energy * energy_) : 0;
  fit.gradient = Stacked(target.gradient_x, target.gradient_y, terms_) - mean_gradient_ * target.g -
                 slope_ * with_f;
  fit.residual = std::max(0.0, fit.energy - with_f * fit.gain);
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
  if (!(gain > kLeastGain) || !delta.allFinite()) return false;
  step = SubsetWarp();
  for (int k = 0; k < terms_; ++k) {
    step.c(0, k) = delta[k] / gain;
    step.c(1, k) = delta[terms_ + k] / gain;
  }
  return true;
}

double NormalEquations::LeftAfterStep(const Fit& fit) const {
  const double weakest = 1 / std::pow(std::max(scale_[0], scale_[terms_]), 2);
  return kNoiseInGradient / 2 * fit.residual / (fit.gain * fit.gain) / weakest;
}

NormalEquations::Fit NormalEquations::Foreseen(const Fit& fit) const {
  ShapeVector half = scale_.cwiseProduct(fit.gradient);
  factor_.triangularView<Eigen::Lower>().solveInPlace(half);
  Fit after = fit;
  after.residual = std::max(0.0, fit.residual - half.squaredNorm());
  if (fit.energy > 0) after.zncc = std::sqrt(1 - std::min(1.0, after.residual / fit.energy));
  return after;
}

NormalEquations::Covariance NormalEquations::CovariancePerVariance(const ProductSums* noise) const {
  // Of the scaled unknowns: with H~ = L L', first the wanted columns W = H~^-1 E, then W' M~ W.
  const int wanted = std::min(terms_, 3);
  return WithSize(unknowns(), [&](auto size) -> Covariance {
    constexpr int kColumns = std::min<int>(size, 6);
    using Square = Eigen::Matrix<double, size, size>;
    using Columns = Eigen::Matrix<double, size, kColumns>;
    const Square factor = factor_;
    Columns solved = Columns::Zero();
    for (int k = 0; k < wanted; ++k) {
      solved(k, k) = 1;
      solved(terms_ + k, wanted + k) = 1;
    }
    factor.template triangularView<Eigen::Lower>().solveInPlace(solved);
    Eigen::Matrix<double, kColumns, kColumns> covariance;
    if (noise == nullptr) {
      covariance.noalias() = solved.transpose() * solved;
    } else {
      factor.template triangularView<Eigen::Lower>().transpose().solveInPlace(solved);
      // Gain and offset take out what is smooth over the subset, which the filter leaves as it is.
      const Square of_noise = Assemble(*noise) - OfGainAndOffset();
      const Square scaled = scale_.asDiagonal() * of_noise * scale_.asDiagonal();
      const Columns half = scaled * solved;
      covariance.noalias() = solved.transpose() * half;
    }
    Eigen::Matrix<double, kColumns, 1> scale;
    for (int k = 0; k < wanted; ++k) {
      scale[k] = scale_[k];
      scale[wanted + k] = scale_[terms_ + k];
    }
    return scale.asDiagonal() * covariance * scale.asDiagonal();
  });
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
