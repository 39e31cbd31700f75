#include "calib/internal/epipolar_residual.h"

#include <cmath>

namespace plumbline::internal {

EpipolarResidual EvaluateEpipolar(const MatchRays& match, const Eigen::Matrix3d& R,
                                  const Eigen::Vector3d& t, const Eigen::Matrix<double, 3, 2>& B) {
  EpipolarResidual out;
  const Eigen::Vector3d& r1 = match.r1;
  const Eigen::Vector3d u = R * match.r0;
  const Eigen::Matrix<double, 3, 2> G0 = R * match.F0;
  const Eigen::Vector3d m = t.cross(u);  // normal of the epipolar plane
  const Eigen::Vector3d n = r1.cross(t);
  const EpipolarConstraint at(match.r0, match.F0, r1, match.F1, R, t);
  const Eigen::Vector4d Sg = match.cov_px2 * at.d_pixels;
  out.sigma = std::sqrt(at.d_pixels.dot(Sg));
  out.z = at.a / out.sigma;
  out.distance_px = at.a / at.per_px();
  out.sigma_px = out.sigma / at.per_px();
  out.d_a << m.cross(r1).transpose(), u.cross(r1).transpose() * B;
  out.d_a /= out.sigma;
  Eigen::Matrix<double, 4, 5> d_g;
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector3d c = G0.col(k).cross(r1);
    d_g.row(k) << (G0.col(k).cross(n) + t.cross(c)).transpose(), c.transpose() * B;
    const Eigen::Vector3d f = match.F1.col(k);
    d_g.row(2 + k) << m.cross(f).transpose(), u.cross(f).transpose() * B;
  }
  out.d_z = out.d_a - out.z / (out.sigma * out.sigma) * (Sg.transpose() * d_g);
  return out;
}

}  // namespace plumbline::internal
