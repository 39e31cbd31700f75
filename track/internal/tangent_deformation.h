#pragma once

#include <Eigen/Core>
#include <optional>

namespace plumbline::internal {

// Two tangents of a surface, along growing columns and rows of the grid (mm per px).
using Tangents = Eigen::Matrix<double, 3, 2>;

// The deformation of a surface within its tangent planes, with its exact derivatives.
struct TangentDeformation {
  Eigen::Matrix3d axes;  // columns e1, e2 and the normal of the reference surface
  // From (e1, e2) to the deformed axes (f1, f2): d(f1, f2) = F d(e1, e2).
  Eigen::Matrix2d F;
  // d(F11, F12, F21, F22) / d(tangents), these row by row: (x by column, x by row, y by column,
  // ...).
  Eigen::Matrix<double, 4, 6> d_reference, d_now;
};

// With the tangents A of the reference and a of the deformed surface:
//   n = -A1 x A2 / |A1 x A2|, towards the camera that sees columns to the right and rows downwards;
//   e1 = A1 / |A1| or, with an x direction, its projection onto the tangent plane; e2 = n x e1;
//   f_i = Q e_i, Q the smallest rotation with Q n = n', n' of a like n of A,
//   Q e_i = e_i - (n'.e_i) (n + n') / (1 + n.n');
//   F = [f]' a T^-1,  T = [e]' A.
// The derivatives count that the axes go with the tangents: in their plane by w_e = e2.de1 and
//   w_f = f2.df1 = w_e - (n x n').(dn + dn') / (1 + n.n')
// (the area of the spherical triangles n, n', n' + dn' and n, n', n + dn).
//
// NaN where the tangents span no plane or the x direction is normal to the surface (within 1e-6),
// or where n' = -n.
TangentDeformation DeformationOf(const Tangents& reference, const Tangents& now,
                                 const std::optional<Eigen::Vector3d>& x_direction);

}  // namespace plumbline::internal
