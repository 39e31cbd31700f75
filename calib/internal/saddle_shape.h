#pragma once

#include <Eigen/Core>
#include <cmath>

#include "calib/internal/two_level_fit.h"

namespace plumbline::internal {

// The geometry of two blurred edges that cross, for TwoLevelFit.
// Order of the parameters: position, directions of the edges, blur.
struct SaddleShape {
  enum : int { kAngle = 2, kBlur = 4 };
  static constexpr int kParameters = 5;
  using Parameters = Eigen::Matrix<double, kParameters, 1>;

  Eigen::Vector2d start_angles;
  double radius_px = 0;

  // Covered: the quadrant between edge 0 and edge 1, and the one opposite.
  static double Share(const Parameters& q, const Eigen::Vector2d& p, Parameters& slope) {
    const Eigen::Vector2d offset = p - q.head<2>();
    double side[2], density[2], d[2];
    Eigen::Vector2d normal[2];
    for (int k = 0; k < 2; ++k) {
      const double angle = q[kAngle + k];
      // Turned so that the point between the directions is on the positive side of both edges.
      const double turn = k == 0 ? 1 : -1;
      normal[k] = turn * Eigen::Vector2d(-std::sin(angle), std::cos(angle));
      d[k] = normal[k].dot(offset);
      const BlurredEdge edge(d[k], q[kBlur]);
      side[k] = 1 - 2 * edge.share;
      density[k] = 2 * edge.density;
    }
    slope.setZero();
    for (int k = 0; k < 2; ++k) {
      if (density[k] == 0) continue;
      const double by_d = 0.5 * side[1 - k] * density[k];
      const double turn = k == 0 ? 1 : -1, angle = q[kAngle + k];
      slope.head<2>() -= by_d * normal[k];
      slope[kAngle + k] =
          -by_d * turn * Eigen::Vector2d(std::cos(angle), std::sin(angle)).dot(offset);
      slope[kBlur] -= by_d * d[k] / q[kBlur];
    }
    return 0.5 * (1 + side[0] * side[1]);
  }

  bool Plausible(const Parameters& q) const {
    return q.head<2>().norm() < 0.5 * radius_px && q[kBlur] > 0.05 && q[kBlur] < radius_px &&
           std::abs(q[kAngle] - start_angles[0]) < 0.5 &&
           std::abs(q[kAngle + 1] - start_angles[1]) < 0.5;
  }
};

}  // namespace plumbline::internal
