#pragma once

#include <Eigen/Core>

namespace plumbline::internal {

// a kron b: with G row by row, d(A G B) = Kronecker(A, B') dG.
inline Eigen::Matrix4d Kronecker(const Eigen::Matrix2d& a, const Eigen::Matrix2d& b) {
  Eigen::Matrix4d m;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) m.block<2, 2>(2 * i, 2 * j) = a(i, j) * b;
  }
  return m;
}

}  // namespace plumbline::internal
