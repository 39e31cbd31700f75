#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "calib/internal/disc_fit.h"
#include "calib/internal/two_level_fit.h"

namespace plumbline::internal {

// The geometry of a blurred disc (or ring) for TwoLevelFit, relative to the middle of its window.
// Order of the parameters: centre, shape (m11, m12, m22), blur; a ring's hole: centre, size
// relative to the ring.

// Distance to an ellipse, positive outside, with derivatives.
struct EdgeDistance {
  double d = 0;
  Eigen::Vector2d d_offset;  // with respect to the point minus the centre
  Eigen::Vector3d d_shape;   // with respect to m11, m12, m22
};

inline EdgeDistance DistanceToEdge(const Eigen::Vector2d& offset, const Eigen::Matrix2d& shape) {
  const Eigen::Vector2d gradient = shape * offset;
  const double rho = std::sqrt(std::max(offset.dot(gradient), 1e-12));
  const double g = std::max(gradient.norm(), 1e-12);
  EdgeDistance out;
  out.d = (rho * rho - rho) / g;
  const double by_rho = (2 * rho - 1) / g, by_g = -out.d / g;
  out.d_offset = by_rho / rho * gradient + by_g / g * (shape * gradient);
  const double x = offset.x(), y = offset.y();
  out.d_shape =
      by_rho / (2 * rho) * Eigen::Vector3d(x * x, 2 * x * y, y * y) +
      by_g / g *
          Eigen::Vector3d(gradient.x() * x, gradient.x() * y + gradient.y() * x, gradient.y() * y);
  return out;
}

template <bool kRing>
struct DiscShape {
  enum : int { kShape = 2, kBlur = 5, kHole = 6, kHoleSize = 8 };
  static constexpr int kParameters = kRing ? 9 : 6;
  using Parameters = Eigen::Matrix<double, kParameters, 1>;

  Ellipse start;

  static Eigen::Matrix2d Matrix(const Parameters& q) {
    return (Eigen::Matrix2d() << q[kShape], q[kShape + 1], q[kShape + 1], q[kShape + 2]).finished();
  }

  static double Share(const Parameters& q, const Eigen::Vector2d& p, Parameters& slope) {
    const Eigen::Matrix2d shape = Matrix(q);
    const EdgeDistance outer = DistanceToEdge(p - q.template head<2>(), shape);
    const BlurredEdge edge(outer.d, q[kBlur]);
    slope.setZero();
    if (edge.density > 0) {
      slope.template head<2>() = edge.density * outer.d_offset;
      slope.template segment<3>(kShape) = -edge.density * outer.d_shape;
      slope[kBlur] = edge.density * outer.d / q[kBlur];
    }
    if constexpr (kRing) return edge.share - HoleShare(q, shape, p, slope);
    return edge.share;
  }

  bool Plausible(const Parameters& q) const {
    const Eigen::Matrix2d shape = Matrix(q);
    if (!(shape.determinant() > 0) || !(shape.trace() > 0)) return false;
    const double radius = start.MeanRadiusPx();
    const double ratio = std::pow(start.shape.determinant() / shape.determinant(), 0.25);
    if (ratio < 0.6 || ratio > 1.6 || q.template head<2>().norm() > 0.4 * radius) return false;
    if (q[kBlur] < 0.05 || q[kBlur] > 1.2 * radius) return false;
    if constexpr (kRing) return q[kHoleSize] > 0.05 && q[kHoleSize] < 0.95;
    return true;
  }

 private:
  static double HoleShare(const Parameters& q, const Eigen::Matrix2d& shape,
                          const Eigen::Vector2d& p, Parameters& slope) {
    const double f = q[kHoleSize];
    const EdgeDistance inner = DistanceToEdge(p - q.template segment<2>(kHole), shape / (f * f));
    const BlurredEdge edge(inner.d, q[kBlur]);
    if (edge.density > 0) {
      slope.template segment<3>(kShape) += edge.density * inner.d_shape / (f * f);
      slope[kBlur] -= edge.density * inner.d / q[kBlur];
      slope.template segment<2>(kHole) = -edge.density * inner.d_offset;
      slope[kHoleSize] =
          edge.density * inner.d_shape.dot(q.template segment<3>(kShape)) * -2 / (f * f * f);
    }
    return edge.share;
  }
};

}  // namespace plumbline::internal
