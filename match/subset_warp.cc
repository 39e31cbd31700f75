#include "match/subset_warp.h"

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <stdexcept>

namespace plumbline {
namespace {

using Polynomial = Eigen::Matrix<double, 1, 6>;  // on the monomials of SubsetWarp

// Where each coordinate goes: the shift plus the coordinate itself.
std::array<Polynomial, 2> Coordinates(const SubsetWarp& warp) {
  std::array<Polynomial, 2> to = {warp.c.row(0), warp.c.row(1)};
  to[0][1] += 1;
  to[1][2] += 1;
  return to;
}

SubsetWarp FromCoordinates(const std::array<Polynomial, 2>& to) {
  SubsetWarp warp;
  warp.c.row(0) = to[0];
  warp.c.row(1) = to[1];
  warp.c(0, 1) -= 1;
  warp.c(1, 2) -= 1;
  return warp;
}

// a b, cut after the second order.
Polynomial Product(const Polynomial& a, const Polynomial& b) {
  Polynomial p;
  p[0] = a[0] * b[0];
  p[1] = a[0] * b[1] + a[1] * b[0];
  p[2] = a[0] * b[2] + a[2] * b[0];
  p[3] = a[0] * b[3] + a[1] * b[1] + a[3] * b[0];
  p[4] = a[0] * b[4] + a[1] * b[2] + a[2] * b[1] + a[4] * b[0];
  p[5] = a[0] * b[5] + a[2] * b[2] + a[5] * b[0];
  return p;
}

}  // namespace

SubsetWarp SubsetWarp::Of(const Eigen::Vector2d& displacement_px, const Eigen::Matrix2d& gradient) {
  SubsetWarp warp;
  warp.c.col(0) = displacement_px;
  warp.c.block<2, 2>(0, 1) = gradient;
  return warp;
}

Eigen::Vector2d SubsetWarp::Apply(const Eigen::Vector2d& offset_px) const {
  const double x = offset_px.x();
  const double y = offset_px.y();
  Eigen::Matrix<double, 6, 1> monomials;
  monomials << 1, x, y, x * x, x * y, y * y;
  return offset_px + c * monomials;
}

SubsetWarp SubsetWarp::MovedTo(const Eigen::Vector2d& offset_px) const {
  const double x = offset_px.x();
  const double y = offset_px.y();
  SubsetWarp moved = *this;
  moved.c.col(0) = Apply(offset_px) - offset_px;
  moved.c.col(1) += 2 * x * c.col(3) + y * c.col(4);
  moved.c.col(2) += x * c.col(4) + 2 * y * c.col(5);
  return moved;
}

SubsetWarp Compose(const SubsetWarp& outer, const SubsetWarp& inner) {
  const auto [x, y] = Coordinates(inner);
  const std::array<Polynomial, 6> monomials = {
      Polynomial(1, 0, 0, 0, 0, 0), x, y, Product(x, x), Product(x, y), Product(y, y)};
  auto to = Coordinates(outer);
  for (Polynomial& polynomial : to) {
    const Polynomial of_inner = polynomial;
    polynomial.setZero();
    for (int k = 0; k < 6; ++k) polynomial += of_inner[k] * monomials[static_cast<std::size_t>(k)];
  }
  return FromCoordinates(to);
}

SubsetWarp Inverse(const SubsetWarp& warp) {
  const Eigen::Matrix2d affine = Eigen::Matrix2d::Identity() + warp.gradient();
  if (!(affine.determinant() > 0) || !warp.c.allFinite()) {
    throw std::domain_error("Inverse: the warp folds the subset over");
  }
  // With w(x) = t + A x + q(x): the inverse's affine part undoes the affine one about t, and its
  // second order is what cancels q there.
  const Eigen::Matrix2d back = affine.inverse();
  SubsetWarp inverse = SubsetWarp::Of(-back * warp.c.col(0), back - Eigen::Matrix2d::Identity());
  if (warp.c.rightCols<3>().isZero(0)) return inverse;
  // w(inverse(x)) - x is of first order in q; two Newton steps leave nothing below the third order.
  for (int step = 0; step < 3; ++step) {
    const SubsetWarp excess = Compose(warp, inverse);
    inverse.c -= back * excess.c;
  }
  return inverse;
}

}  // namespace plumbline
