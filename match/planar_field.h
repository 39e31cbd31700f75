#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "calib/image.h"
#include "calib/status.h"

namespace plumbline {

// What correlation found at the points of interest (POIs) of a regular grid in the reference image:
// one camera, everything in pixels. All images have the size of the grid: row r, column c is the
// pixel (first_px.x() + c step_px, first_px.y() + r step_px). NaN where status is not kOk.
struct PlanarField {
  Eigen::Vector2i first_px{0, 0};
  int step_px = 1;
  int subset_px = 0;  // side (diameter) of the subset
  int order = 1;      // of the shape function

  Image<Eigen::Vector2d> displacement_px;  // deformed - reference
  Image<Eigen::Matrix2f> gradient;  // (du/dx, du/dy; dv/dx, dv/dy), of the subset's shape function
  // Covariances from independent noise of both images.
  Image<Eigen::Vector3f> cov_displacement_px2;  // uu, uv, vv
  // Of (du/dx, du/dy, dv/dx, dv/dy): upper triangle, row by row (10 numbers).
  Image<Eigen::Matrix<float, 10, 1>> cov_gradient;
  // Of the variances, what is due to the noise of the reference image. All matches of one reference
  // have these errors in common.
  Image<float> reference_share;
  Image<float> zncc;  // zero-normalised cross-correlation of the subsets, -1..1
  Image<std::uint8_t> iterations;
  Image<Status> status;

  PlanarField() = default;
  PlanarField(ImageSize grid, const Eigen::Vector2i& first_px, int step_px);

  ImageSize size() const { return status.size(); }
  Eigen::Vector2d PixelOf(int row, int column) const {
    return {first_px.x() + column * step_px, first_px.y() + row * step_px};
  }
};

// The covariances of a field as matrices, and back: (u, v) from 3 numbers, a strain's (xx, yy, xy)
// from 6, (du/dx, du/dy, dv/dx, dv/dy) from 10, the upper triangle row by row.
Eigen::Matrix2d CovarianceOf(const Eigen::Vector3f& triangle);
Eigen::Matrix3d CovarianceOf(const Eigen::Matrix<float, 6, 1>& triangle);
Eigen::Matrix4d CovarianceOf(const Eigen::Matrix<float, 10, 1>& triangle);
Eigen::Vector3f TriangleOf(const Eigen::Matrix2d& covariance);
Eigen::Matrix<float, 6, 1> TriangleOf(const Eigen::Matrix3d& covariance);
Eigen::Matrix<float, 10, 1> TriangleOf(const Eigen::Matrix4d& covariance);

}  // namespace plumbline
