#pragma once

#include <Eigen/Core>

namespace plumbline {

// The second order of a shape function, columns 3 to 5 of SubsetWarp::c (1 / px).
using SubsetCurvature = Eigen::Matrix<float, 2, 3>;

// The shape function of a subset: where the point at offset (x, y) from the subset's centre goes,
//   x + sum_k c(0, k) m_k(x, y),   y + sum_k c(1, k) m_k(x, y),   m = (1, x, y, x^2, x y, y^2),
// in pixels. Column 0 is the displacement of the centre, columns 1 and 2 its gradient; columns 3 to
// 5 are the second order (half the second derivatives for x^2 and y^2).
struct SubsetWarp {
  Eigen::Matrix<double, 2, 6> c = Eigen::Matrix<double, 2, 6>::Zero();

  static SubsetWarp Of(const Eigen::Vector2d& displacement_px,
                       const Eigen::Matrix2d& gradient = Eigen::Matrix2d::Zero());

  Eigen::Vector2d displacement_px() const { return c.col(0); }
  Eigen::Matrix2d gradient() const { return c.block<2, 2>(0, 1); }

  // The offset, from the centre in the reference, of where `offset_px` goes.
  Eigen::Vector2d Apply(const Eigen::Vector2d& offset_px) const;

  // The same motion told from another centre, offset_px away from this one.
  SubsetWarp MovedTo(const Eigen::Vector2d& offset_px) const;
};

// outer(inner(x)), cut after the second order: exact for affine warps.
SubsetWarp Compose(const SubsetWarp& outer, const SubsetWarp& inner);

// The warp that undoes this one, cut after the second order. Throws std::domain_error where it
// folds the subset over (determinant of the affine part not positive).
SubsetWarp Inverse(const SubsetWarp& warp);

}  // namespace plumbline
