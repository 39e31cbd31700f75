#include "io/planar_series.h"

#include <cmath>
#include <limits>

#include "io/internal/planar_layout.h"
#include "io/series_frame.h"

namespace plumbline {

std::vector<std::string> Names(const PlanarContents& contents) {
  return internal::NamesOf(contents);
}

PrincipalStrainSigma SigmaOfPrincipal(const Eigen::Vector3f& strain,
                                      const Eigen::Matrix<float, 6, 1>& covariance) {
  const float angle = PrincipalOf(strain).angle_rad;
  const float radius = std::hypot(0.5f * (strain[0] - strain[1]), strain[2]);  // of Mohr's circle
  const float c = std::cos(angle), s = std::sin(angle);
  // The principal strains are n' E n, n the unit vectors along their directions; the circle's
  // angle is twice the direction's.
  Eigen::Matrix3f J;
  J.row(0) << c * c, s * s, 2 * c * s;
  J.row(1) << s * s, c * c, -2 * c * s;
  const float sine = std::sin(2 * angle), cosine = std::cos(2 * angle);
  J.row(2) << -sine, sine, 2 * cosine;
  J.row(2) /= 4 * radius;
  Eigen::Matrix3f cov;
  cov << covariance[0], covariance[1], covariance[2],  //
      covariance[1], covariance[3], covariance[4],     //
      covariance[2], covariance[4], covariance[5];
  const Eigen::Vector3f sigma = (J * cov * J.transpose()).diagonal().cwiseSqrt();
  return {sigma.head<2>(), sigma[2]};
}

}  // namespace plumbline
