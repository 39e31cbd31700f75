#include "match/planar_field.h"

#include <limits>

namespace plumbline {

PlanarField::PlanarField(ImageSize grid, const Eigen::Vector2i& first, int step)
    : first_px(first), step_px(step) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  constexpr float kNoFloat = std::numeric_limits<float>::quiet_NaN();
  displacement_px = Image<Eigen::Vector2d>(grid, Eigen::Vector2d::Constant(kNone));
  gradient = Image<Eigen::Matrix2f>(grid, Eigen::Matrix2f::Constant(kNoFloat));
  cov_displacement_px2 = Image<Eigen::Vector3f>(grid, Eigen::Vector3f::Constant(kNoFloat));
  cov_gradient =
      Image<Eigen::Matrix<float, 10, 1>>(grid, Eigen::Matrix<float, 10, 1>::Constant(kNoFloat));
  zncc = Image<float>(grid, kNoFloat);
  iterations = Image<std::uint8_t>(grid, 0);
  status = Image<Status>(grid, Status::kNotConverged);
}

}  // namespace plumbline
