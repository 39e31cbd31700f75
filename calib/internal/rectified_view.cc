#include "calib/internal/rectified_view.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace

Eigen::Vector2d RectifiedProjection::Project(const Eigen::Vector3d& p,
                                             Eigen::Matrix<double, 2, 3>* d_pixel_d_point) const {
  const double fx = intrinsics[0], fy = intrinsics[1];
  if (kind == RectificationKind::kPinhole) {
    if (!(p.z() > 0)) {
      if (d_pixel_d_point != nullptr) d_pixel_d_point->setConstant(kNaN);
      return {kNaN, kNaN};
    }
    const double u = p.x() / p.z(), v = p.y() / p.z();
    if (d_pixel_d_point != nullptr) {
      *d_pixel_d_point << fx / p.z(), 0, -fx * u / p.z(), 0, fy / p.z(), -fy * v / p.z();
    }
    return {fx * u + intrinsics[2], fy * v + intrinsics[3]};
  }
  const double h = std::hypot(p.y(), p.z());
  if (d_pixel_d_point != nullptr) {
    const double n2 = p.squaredNorm();
    *d_pixel_d_point << fx * h / n2, -fx * p.x() * p.y() / (h * n2), -fx * p.x() * p.z() / (h * n2),
        0, fy * p.z() / (h * h), -fy * p.y() / (h * h);
  }
  return {fx * std::atan2(p.x(), h) + intrinsics[2], fy * std::atan2(p.y(), p.z()) + intrinsics[3]};
}

Eigen::Vector3d RectifiedProjection::Unproject(const Eigen::Vector2d& pixel,
                                               Eigen::Matrix<double, 3, 2>* d_ray_d_pixel) const {
  const double fx = intrinsics[0], fy = intrinsics[1];
  const double u = (pixel.x() - intrinsics[2]) / fx, v = (pixel.y() - intrinsics[3]) / fy;
  if (kind == RectificationKind::kPinhole) {
    if (d_ray_d_pixel != nullptr) *d_ray_d_pixel << 1 / fx, 0, 0, 1 / fy, 0, 0;
    return {u, v, 1};
  }
  const double su = std::sin(u), cu = std::cos(u), sv = std::sin(v), cv = std::cos(v);
  if (d_ray_d_pixel != nullptr) {
    *d_ray_d_pixel << cu / fx, 0, -su * sv / fx, cu * cv / fy, -su * cv / fx, -cu * sv / fy;
  }
  return {su, cu * sv, cu * cv};
}

Eigen::Vector3d RectifiedView::DirectionInCamera(const Eigen::Vector2d& rectified,
                                                 Eigen::Matrix<double, 3, 2>* d) const {
  const Eigen::Vector3d direction =
      rectified_from_camera.transpose() * projection.Unproject(rectified, d);
  if (d != nullptr) *d = (rectified_from_camera.transpose() * *d).eval();
  if (!(direction.z() >= cos_largest_angle * direction.norm())) {
    return Eigen::Vector3d::Constant(kNaN);
  }
  return direction;
}

Eigen::Vector2d RectifiedView::RawPixel(const Eigen::Vector2d& rectified,
                                        Eigen::Matrix2d* d) const {
  if (d == nullptr) return camera.Project(DirectionInCamera(rectified, nullptr));
  Eigen::Matrix<double, 3, 2> d_direction;
  const Eigen::Vector3d direction = DirectionInCamera(rectified, &d_direction);
  Eigen::Vector2d pixel;
  Eigen::Matrix<double, 2, 3> G;
  camera.ProjectWithPointJacobians({&direction, 1}, {&pixel, 1},
                                   std::span<Eigen::Matrix<double, 2, 3>>(&G, 1));
  *d = G * d_direction;
  return pixel;
}

Eigen::Vector2d RectifiedView::RectifiedPixel(const Eigen::Vector2d& raw,
                                              Eigen::Matrix2d* d) const {
  Eigen::Vector3d ray;
  Eigen::Matrix<double, 3, 2> F;
  if (d == nullptr) {
    ray = camera.Unproject(raw);
    return ray.allFinite() ? projection.Project(rectified_from_camera * ray)
                           : Eigen::Vector2d(kNaN, kNaN);
  }
  camera.UnprojectWithPixelJacobians({&raw, 1}, {&ray, 1},
                                     std::span<Eigen::Matrix<double, 3, 2>>(&F, 1));
  Eigen::Matrix<double, 2, 3> P;
  const Eigen::Vector2d pixel = projection.Project(rectified_from_camera * ray, &P);
  *d = P * rectified_from_camera * F;
  return pixel;
}

RectificationMap MakeMap(const RectifiedView& view, ImageSize size) {
  RectificationMap map{Image<float>(size), Image<float>(size)};
  tbb::parallel_for(tbb::blocked_range<int>(0, size.height), [&](const auto& rows) {
    const auto width = static_cast<std::size_t>(size.width);
    std::vector<Eigen::Vector3d> directions(width);
    std::vector<Eigen::Vector2d> pixels(width);
    for (int y = rows.begin(); y != rows.end(); ++y) {
      for (std::size_t x = 0; x < width; ++x) {
        directions[x] =
            view.DirectionInCamera({static_cast<double>(x), static_cast<double>(y)}, nullptr);
      }
      view.camera.Project(directions, pixels);
      for (std::size_t x = 0; x < width; ++x) {
        map.x.row(y)[x] = static_cast<float>(pixels[x].x());
        map.y.row(y)[x] = static_cast<float>(pixels[x].y());
      }
    }
  });
  return map;
}

// Not cv::remap: it rounds the place to 1/32 px, which shifts what is matched by up to 1/64 px.
GrayImage Remap(const RectificationMap& map, const GrayImage& image, Image<std::uint8_t>* valid) {
  GrayImage out{Image<std::uint16_t>(map.x.size()), image.bits};
  if (valid != nullptr) *valid = Image<std::uint8_t>(map.x.size());
  const auto right = static_cast<float>(image.width() - 1);
  const auto bottom = static_cast<float>(image.height() - 1);
  tbb::parallel_for(tbb::blocked_range<int>(0, out.height()), [&](const auto& rows) {
    for (int row = rows.begin(); row != rows.end(); ++row) {
      for (int column = 0; column < out.width(); ++column) {
        const float x = map.x(row, column), y = map.y(row, column);
        if (!(x >= 0 && y >= 0 && x <= right && y <= bottom)) continue;  // also where NaN
        const int x0 = std::min(static_cast<int>(x), image.width() - 2);
        const int y0 = std::min(static_cast<int>(y), image.height() - 2);
        const float a = x - static_cast<float>(x0), b = y - static_cast<float>(y0);
        const std::uint16_t* const above = image.grey.row(y0) + x0;
        const std::uint16_t* const below = image.grey.row(y0 + 1) + x0;
        const float value =
            (1 - b) * ((1 - a) * static_cast<float>(above[0]) + a * static_cast<float>(above[1])) +
            b * ((1 - a) * static_cast<float>(below[0]) + a * static_cast<float>(below[1]));
        out.grey(row, column) = static_cast<std::uint16_t>(value + 0.5F);
        if (valid != nullptr) (*valid)(row, column) = 255;
      }
    }
  });
  return out;
}

}  // namespace plumbline::internal
