#include "track/internal/tangent_deformation.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <limits>

namespace plumbline::internal {
namespace {

// Below this sine of the angle between two directions they are taken as one.
constexpr double kSmallestSine = 1e-6;
const Eigen::Vector3d kNone = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());

Eigen::Vector3d NormalOf(const Tangents& tangents) {
  const Eigen::Vector3d across = tangents.col(1).cross(tangents.col(0));
  const double norm = across.norm();
  if (!(norm > kSmallestSine * tangents.col(0).norm() * tangents.col(1).norm())) return kNone;
  return across / norm;
}

// How the normal n turns with the tangents: dn = [axes] y with y = -T^-T dA' n, T = [axes]' A.
Eigen::Matrix<double, 2, 6> TurnOf(const Eigen::Matrix2d& inverse, const Eigen::Vector3d& normal) {
  Eigen::Matrix<double, 2, 6> turn;
  for (int i = 0; i < 3; ++i) turn.middleCols<2>(2 * i) = -normal[i] * inverse.transpose();
  return turn;
}

}  // namespace

TangentDeformation DeformationOf(const Tangents& reference, const Tangents& now,
                                 const std::optional<Eigen::Vector3d>& x_direction) {
  using Row6 = Eigen::Matrix<double, 1, 6>;
  const Eigen::Vector3d n = NormalOf(reference), n_now = NormalOf(now);
  const Eigen::Vector3d along = x_direction ? x_direction->normalized() : reference.col(0).eval();
  const Eigen::Vector3d in_plane = along - n * n.dot(along);
  TangentDeformation out;
  out.axes.col(0) = in_plane.normalized();
  if (!(in_plane.norm() > kSmallestSine * along.norm())) out.axes.col(0) = kNone;
  out.axes.col(1) = n.cross(out.axes.col(0));
  out.axes.col(2) = n;
  const auto e = out.axes.leftCols<2>();
  const Eigen::Vector3d between = (n + n_now) / (1 + n.dot(n_now));
  const Tangents f = e - between * (n_now.transpose() * e);
  const Eigen::Matrix2d inverse = (e.transpose() * reference).inverse();  // T^-1
  out.F = f.transpose() * now * inverse;

  const Eigen::Matrix<double, 2, 6> turn = TurnOf(inverse, n);
  const Eigen::Matrix<double, 2, 6> turn_now = TurnOf((f.transpose() * now).inverse(), n_now);
  Row6 spin = Row6::Zero();  // w_e
  if (x_direction) {
    spin = -n.dot(along) / in_plane.norm() * turn.row(1);
  } else {
    for (int i = 0; i < 3; ++i) spin[2 * i] = e(i, 1) / reference.col(0).norm();
  }
  const Eigen::RowVector3d twist = n.cross(n_now).transpose() / (1 + n.dot(n_now));
  const Row6 spin_now_by_reference = spin - twist * e * turn;  // w_f
  const Row6 spin_now = -twist * f * turn_now;

  // dF = [f]' da T^-1 + w_f K F - F [e]' dA T^-1 - w_e F K
  Eigen::Matrix2d K;
  K << 0, 1, -1, 0;
  const Eigen::Matrix2d KF = K * out.F, FK = out.F * K;
  const Eigen::Matrix<double, 2, 3> Fe = out.F * e.transpose();
  for (int r = 0; r < 2; ++r) {
    for (int s = 0; s < 2; ++s) {
      out.d_reference.row(2 * r + s) = KF(r, s) * spin_now_by_reference - FK(r, s) * spin;
      out.d_now.row(2 * r + s) = KF(r, s) * spin_now;
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 2; ++j) {
          out.d_reference(2 * r + s, 2 * i + j) -= Fe(r, i) * inverse(j, s);
          out.d_now(2 * r + s, 2 * i + j) += f(i, r) * inverse(j, s);
        }
      }
    }
  }
  return out;
}

}  // namespace plumbline::internal
