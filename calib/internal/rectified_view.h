#pragma once

#include <Eigen/Core>

#include "calib/camera.h"
#include "calib/rectify.h"

namespace plumbline::internal {

// A virtual camera that is pinhole or lat-lon, without distortion. Source: mrcal_project_pinhole
// and mrcal_project_latlon; the Jacobians are theirs by hand.
struct RectifiedProjection {
  RectificationKind kind = RectificationKind::kPinhole;
  Eigen::Vector4d intrinsics{1, 1, 0, 0};  // fx, fy, cx, cy

  // NaN for z <= 0 in a pinhole.
  Eigen::Vector2d Project(const Eigen::Vector3d& p,
                          Eigen::Matrix<double, 2, 3>* d_pixel_d_point = nullptr) const;
  // A viewing direction, not of unit length.
  Eigen::Vector3d Unproject(const Eigen::Vector2d& pixel,
                            Eigen::Matrix<double, 3, 2>* d_ray_d_pixel = nullptr) const;
};

// One real camera beside its virtual one.
struct RectifiedView {
  Camera camera;
  Eigen::Matrix3d rectified_from_camera;
  RectifiedProjection projection;
  // Cosine of the largest angle off the optical axis that the photograph shows, with 2 % to spare:
  // beyond it the lens polynomial may fold back into the image.
  double cos_largest_angle = -1;

  Eigen::Vector2d RawPixel(const Eigen::Vector2d& rectified, Eigen::Matrix2d* d) const;
  Eigen::Vector2d RectifiedPixel(const Eigen::Vector2d& raw, Eigen::Matrix2d* d) const;
  // The viewing direction in the camera, NaN beyond the largest angle.
  Eigen::Vector3d DirectionInCamera(const Eigen::Vector2d& rectified,
                                    Eigen::Matrix<double, 3, 2>* d) const;
};

// Raw x and y of every rectified pixel; NaN where the photograph has none.
struct RectificationMap {
  Image<float> x;
  Image<float> y;
};
RectificationMap MakeMap(const RectifiedView& view, ImageSize size);

// Bilinear; `valid` may be null.
GrayImage Remap(const RectificationMap& map, const GrayImage& image, Image<std::uint8_t>* valid);

}  // namespace plumbline::internal
