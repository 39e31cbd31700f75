#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace plumbline {

// A rigid motion, written target_from_source: point_in_target = target_from_source *
// point_in_source.
//
// Units: mm; rotation vectors in radians (axis times angle, Rodrigues).
struct Rigid3 {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation_mm = Eigen::Vector3d::Zero();

  // From a rotation vector r_rad and a translation t_mm.
  static Rigid3 FromRotationVector(const Eigen::Vector3d& r_rad, const Eigen::Vector3d& t_mm);

  // The rotation as a vector whose norm, at most pi, is the angle in radians.
  Eigen::Vector3d RotationVector() const;

  Rigid3 Inverse() const;

  // The 4x4 homogeneous matrix, last row (0, 0, 0, 1).
  Eigen::Matrix4d Matrix() const;

  Eigen::Vector3d operator*(const Eigen::Vector3d& point_mm) const {
    return rotation * point_mm + translation_mm;
  }
};

// target_from_source = a * b with a = target_from_middle, b = middle_from_source.
Rigid3 operator*(const Rigid3& a, const Rigid3& b);

// The matrix of the cross product: Skew(a) * b == a.cross(b).
Eigen::Matrix3d Skew(const Eigen::Vector3d& a);

// R = exp([r]x) of a rotation vector, with dR[k] = dR / dr_k. Exact also at and near r = 0.
//
// Source: Gallego and Yezzi, "A compact formula for the derivative of a 3-D rotation in exponential
// coordinates", 2015, eq. 9.
Eigen::Matrix3d RotationFromVector(const Eigen::Vector3d& r_rad, Eigen::Matrix3d* dR = nullptr);

}  // namespace plumbline
