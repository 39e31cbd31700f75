#include "track/strain_measure.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace plumbline {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Eigen::Vector3d Voigt(const Eigen::Matrix2d& e) {
  return {e(0, 0), e(1, 1), 0.5 * (e(0, 1) + e(1, 0))};
}

// The derivative of F, or of G, to the i-th of (du/dx, du/dy, dv/dx, dv/dy).
Eigen::Matrix2d Unit(int i) {
  Eigen::Matrix2d unit = Eigen::Matrix2d::Zero();
  unit(i / 2, i % 2) = 1;
  return unit;
}

// 1/2 ln C and how it goes with C = F'F: with C = Q diag(c) Q',
//   d f(C) = Q (D o (Q' dC Q)) Q',  D_ij = (f(c_i) - f(c_j)) / (c_i - c_j),  D_ii = f'(c_i)
// (Daleckii and Krein; Higham, Functions of Matrices, theorem 3.11).
void Hencky(const Eigen::Matrix2d& F, GradientStrain& out) {
  const Eigen::Matrix2d C = F.transpose() * F;
  const double mean = 0.5 * (C(0, 0) + C(1, 1)), half = 0.5 * (C(0, 0) - C(1, 1));
  const double radius = std::hypot(half, C(0, 1));
  const double angle = 0.5 * std::atan2(C(0, 1), half);
  // The smaller one from the determinant: no cancellation.
  const double det = F.determinant();
  const Eigen::Vector2d c(mean + radius, det * det / (mean + radius));
  Eigen::Matrix2d Q;
  Q << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  const Eigen::Vector2d f = 0.5 * c.array().log();
  out.strain = Voigt(Q * f.asDiagonal() * Q.transpose());
  const double apart = (c[0] - c[1]) / c[1];
  Eigen::Matrix2d D;
  D(0, 0) = 0.5 / c[0];
  D(1, 1) = 0.5 / c[1];
  D(0, 1) = D(1, 0) = 0.5 / c[1] * (apart > 1e-12 ? std::log1p(apart) / apart : 1);
  for (int i = 0; i < 4; ++i) {
    const Eigen::Matrix2d dF = Unit(i);
    const Eigen::Matrix2d dC = dF.transpose() * F + F.transpose() * dF;
    out.d_strain.col(i) = Voigt(Q * D.cwiseProduct(Q.transpose() * dC * Q) * Q.transpose());
  }
}

// B = F^-1, dB = -B dF B, e = (1 - B'B) / 2.
void Almansi(const Eigen::Matrix2d& F, GradientStrain& out) {
  const Eigen::Matrix2d B = F.inverse();
  out.strain = Voigt(0.5 * (Eigen::Matrix2d::Identity() - B.transpose() * B));
  for (int i = 0; i < 4; ++i) {
    const Eigen::Matrix2d dB = -B * Unit(i) * B;
    out.d_strain.col(i) = Voigt(-0.5 * (dB.transpose() * B + B.transpose() * dB));
  }
}

}  // namespace

GradientStrain StrainOf(const Eigen::Matrix2d& gradient, StrainMeasure measure) {
  GradientStrain out;
  const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + gradient;
  if (!F.allFinite() || !(F.determinant() > 0)) {
    out.strain.setConstant(kNan);
    out.rotation_rad = kNan;
    out.d_strain.setConstant(kNan);
    out.d_rotation.setConstant(kNan);
    return out;
  }
  // F11 + F22 > 0 or not: atan2 is the polar decomposition's angle in the plane either way.
  const double across = F(1, 0) - F(0, 1), along = F(0, 0) + F(1, 1);
  const double norm2 = across * across + along * along;
  out.rotation_rad = std::atan2(across, along);
  out.d_rotation << -across / norm2, -along / norm2, along / norm2, -across / norm2;
  switch (measure) {
    case StrainMeasure::kGreenLagrange:
      // From G, so that small strains keep their digits.
      out.strain = Voigt(0.5 * (gradient + gradient.transpose() + gradient.transpose() * gradient));
      for (int i = 0; i < 4; ++i) out.d_strain.col(i) = Voigt(F.transpose() * Unit(i));
      break;
    case StrainMeasure::kSmall:
      out.strain = Voigt(gradient);
      for (int i = 0; i < 4; ++i) out.d_strain.col(i) = Voigt(Unit(i));
      break;
    case StrainMeasure::kHencky:
      Hencky(F, out);
      break;
    case StrainMeasure::kAlmansi:
      Almansi(F, out);
      break;
  }
  return out;
}

StrainInvariants InvariantsOf(const Eigen::Vector3d& strain) {
  const double xx = strain[0], yy = strain[1], xy = strain[2];
  const double mean = 0.5 * (xx + yy), half = 0.5 * (xx - yy);
  const double radius = std::hypot(half, xy);  // of Mohr's circle
  StrainInvariants out;
  out.principal = {mean + radius, mean - radius};
  out.max_shear = radius;
  const bool apart = radius > 0;
  out.angle_rad = apart ? 0.5 * std::atan2(xy, half) : kNan;
  out.d_max_shear = apart ? Eigen::RowVector3d(0.5 * half, -0.5 * half, xy) / radius
                          : Eigen::RowVector3d::Constant(kNan).eval();
  out.d_angle = apart ? Eigen::RowVector3d(-0.25 * xy, 0.25 * xy, 0.5 * half) / (radius * radius)
                      : Eigen::RowVector3d::Constant(kNan).eval();
  const Eigen::RowVector3d d_mean(0.5, 0.5, 0);
  out.d_principal.row(0) = d_mean + out.d_max_shear;
  out.d_principal.row(1) = d_mean - out.d_max_shear;
  // e1^2 + e1 e2 + e2^2 = xx^2 + xx yy + yy^2 + xy^2.
  const double root = std::sqrt(xx * xx + xx * yy + yy * yy + xy * xy);
  const double factor = 2 / std::sqrt(3.0);
  out.von_mises = factor * root;
  out.d_von_mises = Eigen::RowVector3d(2 * xx + yy, xx + 2 * yy, 2 * xy) *
                    (root > 0 ? 0.5 * factor / root : kNan);
  return out;
}

InvariantSigmas SigmasOf(const StrainInvariants& invariants, const Eigen::Matrix3d& cov_strain) {
  const auto sigma = [&](const Eigen::RowVector3d& d) {
    const double variance = d * cov_strain * d.transpose();
    return std::sqrt(std::max(variance, 0.0));
  };
  return {{sigma(invariants.d_principal.row(0)), sigma(invariants.d_principal.row(1))},
          sigma(invariants.d_angle),
          sigma(invariants.d_max_shear),
          sigma(invariants.d_von_mises)};
}

}  // namespace plumbline
