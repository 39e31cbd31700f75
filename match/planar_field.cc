#include "match/planar_field.h"

#include <limits>

namespace plumbline {
namespace {

template <int kSize, int kNumbers>
Eigen::Matrix<double, kSize, kSize> Unpacked(const Eigen::Matrix<float, kNumbers, 1>& triangle) {
  Eigen::Matrix<double, kSize, kSize> m;
  int next = 0;
  for (int i = 0; i < kSize; ++i) {
    for (int j = i; j < kSize; ++j) m(i, j) = m(j, i) = static_cast<double>(triangle[next++]);
  }
  return m;
}

template <int kNumbers, int kSize>
Eigen::Matrix<float, kNumbers, 1> Packed(const Eigen::Matrix<double, kSize, kSize>& m) {
  Eigen::Matrix<float, kNumbers, 1> triangle;
  int next = 0;
  for (int i = 0; i < kSize; ++i) {
    for (int j = i; j < kSize; ++j) triangle[next++] = static_cast<float>(m(i, j));
  }
  return triangle;
}

}  // namespace

PlanarField::PlanarField(ImageSize grid, const Eigen::Vector2i& first, int step)
    : first_px(first), step_px(step) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  constexpr float kNoFloat = std::numeric_limits<float>::quiet_NaN();
  displacement_px = Image<Eigen::Vector2d>(grid, Eigen::Vector2d::Constant(kNone));
  gradient = Image<Eigen::Matrix2f>(grid, Eigen::Matrix2f::Constant(kNoFloat));
  cov_displacement_px2 = Image<Eigen::Vector3f>(grid, Eigen::Vector3f::Constant(kNoFloat));
  cov_gradient =
      Image<Eigen::Matrix<float, 10, 1>>(grid, Eigen::Matrix<float, 10, 1>::Constant(kNoFloat));
  reference_share = Image<float>(grid, kNoFloat);
  zncc = Image<float>(grid, kNoFloat);
  iterations = Image<std::uint8_t>(grid, 0);
  status = Image<Status>(grid, Status::kNotConverged);
}

Eigen::Matrix2d CovarianceOf(const Eigen::Vector3f& triangle) { return Unpacked<2>(triangle); }
Eigen::Matrix3d CovarianceOf(const Eigen::Matrix<float, 6, 1>& triangle) {
  return Unpacked<3>(triangle);
}
Eigen::Matrix4d CovarianceOf(const Eigen::Matrix<float, 10, 1>& triangle) {
  return Unpacked<4>(triangle);
}
Eigen::Vector3f TriangleOf(const Eigen::Matrix2d& covariance) { return Packed<3>(covariance); }
Eigen::Matrix<float, 6, 1> TriangleOf(const Eigen::Matrix3d& covariance) {
  return Packed<6>(covariance);
}
Eigen::Matrix<float, 10, 1> TriangleOf(const Eigen::Matrix4d& covariance) {
  return Packed<10>(covariance);
}

}  // namespace plumbline
