#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string_view>

namespace plumbline {

// How a displacement gradient G becomes strain; F = 1 + G.
//   kGreenLagrange  E = (F'F - 1) / 2, in the axes of the reference
//   kSmall          (G + G') / 2, the engineering strain: valid for small rotations only
//   kHencky         ln U, U = (F'F)^(1/2), the logarithmic strain, in the axes of the reference
//   kAlmansi        e = (1 - F^-T F^-1) / 2, Euler-Almansi, in the axes of the deformed state
// (Holzapfel, Nonlinear Solid Mechanics, chapter 2.)
enum class StrainMeasure : std::uint8_t { kGreenLagrange = 0, kSmall, kHencky, kAlmansi };

// Names in the order of the enumerators.
inline constexpr std::array<std::string_view, 4> kStrainMeasureNames = {"green_lagrange", "small",
                                                                        "hencky", "almansi"};

constexpr std::string_view Name(StrainMeasure measure) {
  return kStrainMeasureNames[static_cast<std::size_t>(measure)];
}

// Strain in the plane and the rotation, with their exact derivatives to (du/dx, du/dy, dv/dx,
// dv/dy). The strain is (xx, yy, xy), xy the tensor's shear component (half of the engineering
// shear). Without unit.
struct GradientStrain {
  Eigen::Vector3d strain;
  // Of the polar decomposition F = R U, from x towards y, whatever the measure.
  double rotation_rad;
  Eigen::Matrix<double, 3, 4> d_strain;
  Eigen::RowVector4d d_rotation;
};

// NaN where F is not a deformation: not finite, or its determinant not positive.
[[nodiscard]] GradientStrain StrainOf(const Eigen::Matrix2d& gradient, StrainMeasure measure);

// What does not depend on the axes, with derivatives to (xx, yy, xy).
struct StrainInvariants {
  Eigen::Vector2d principal;  // e1 >= e2
  // Of the first one's direction from x towards y, in (-pi/2, pi/2]; NaN where both are equal,
  // since every direction is then a principal one. Then no derivative exists either, but von
  // Mises'.
  double angle_rad;
  double max_shear;  // (e1 - e2) / 2: of the tensor, half of the engineering shear
  // sqrt(2/3 e:e) with the third principal strain -(e1 + e2), as for a material that keeps its
  // volume: 2/sqrt(3) sqrt(e1^2 + e1 e2 + e2^2). It is e1 in simple tension.
  double von_mises;
  Eigen::Matrix<double, 2, 3> d_principal;
  Eigen::RowVector3d d_angle, d_max_shear, d_von_mises;
};

[[nodiscard]] StrainInvariants InvariantsOf(const Eigen::Vector3d& strain);

// One standard deviation each, first order, from the covariance of (xx, yy, xy). NaN where there is
// no derivative.
struct InvariantSigmas {
  Eigen::Vector2d principal;
  double angle_rad, max_shear, von_mises;
};

[[nodiscard]] InvariantSigmas SigmasOf(const StrainInvariants& invariants,
                                       const Eigen::Matrix3d& cov_strain);

}  // namespace plumbline
