#include "io/virtual_rig/material_surface.h"

#include <Eigen/Dense>

namespace plumbline {

Eigen::Vector3d GreenLagrangeStrain(const SurfacePoint& reference, const SurfacePoint& deformed) {
  const Eigen::Matrix<double, 3, 2>& A = reference.d_position_d_material;
  const Eigen::Matrix<double, 3, 2>& B = deformed.d_position_d_material;
  // A = axes * R: d(material) = R^-1 dX, dX in the local axes.
  Eigen::Matrix<double, 3, 2> axes;
  axes.col(0) = A.col(0).normalized();
  axes.col(1) = (A.col(1) - axes.col(0).dot(A.col(1)) * axes.col(0)).normalized();
  const Eigen::Matrix2d R = axes.transpose() * A;
  const Eigen::Matrix<double, 3, 2> F = B * R.inverse();
  const Eigen::Matrix2d E = 0.5 * (F.transpose() * F - Eigen::Matrix2d::Identity());
  return {E(0, 0), E(1, 1), E(0, 1)};
}

}  // namespace plumbline
