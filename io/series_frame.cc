#include "io/series_frame.h"

#include <cmath>

#include "io/internal/series_layout.h"
#include "track/strain_measure.h"

namespace plumbline {

std::vector<std::string> Names(const SeriesContents& contents) {
  return internal::NamesOf(contents);
}

PrincipalStrain PrincipalOf(const Eigen::Vector3f& strain) {
  const StrainInvariants invariants = InvariantsOf(strain.cast<double>());
  return {invariants.principal.cast<float>(), static_cast<float>(invariants.angle_rad)};
}

GroundAngles AnglesOf(const GroundRecord& ground) {
  const Eigen::Vector3d& n = ground.normal_in_rig;
  const double across = std::hypot(n.x(), n.y());
  GroundAngles angles;
  angles.angle_rad << std::atan2(n.y(), -n.z()), std::atan2(-n.x(), -n.z()),
      std::atan2(across, -n.z());
  // d atan2(a, b) = (b da - a db) / (a^2 + b^2)
  Eigen::Matrix3d J;
  const double nyz = n.y() * n.y() + n.z() * n.z();
  const double nxz = n.x() * n.x() + n.z() * n.z();
  J.row(0) << 0, -n.z() / nyz, n.y() / nyz;
  J.row(1) << n.z() / nxz, 0, -n.x() / nxz;
  // Straight down the direction of the inclination is anybody's: take x, where it is largest or
  // not.
  const Eigen::Vector2d u =
      across > 1e-12 ? Eigen::Vector2d(n.head<2>() / across) : Eigen::Vector2d(1, 0);
  J.row(2) << -n.z() * u.x(), -n.z() * u.y(), across;
  // A rotation (a, b) about e1, e2 turns the normal by b e1 - a e2.
  Eigen::Matrix<double, 3, 2> d_normal;
  d_normal << -ground.e2_in_rig, ground.e1_in_rig;
  const Eigen::Matrix<double, 3, 2> d_angle = J * d_normal;
  const auto sigma = [&](const Eigen::Matrix3d& cov) -> Eigen::Vector3d {
    return (d_angle * cov.topLeftCorner<2, 2>() * d_angle.transpose()).diagonal().cwiseSqrt();
  };
  angles.sigma_random_rad = sigma(ground.cov_random);
  angles.sigma_calibration_rad = sigma(ground.cov_calibration);
  return angles;
}

}  // namespace plumbline
