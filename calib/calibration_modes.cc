#include "calib/calibration_modes.h"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <stdexcept>

#include "calib/triangulate.h"

namespace plumbline {

CalibrationModes ChooseModes(const StereoRig& rig, const Eigen::MatrixXd& covariance,
                             double scale_sigma, std::span<const Eigen::Vector3d> working_points_mm,
                             double share) {
  const Eigen::Index P = rig.ParameterCount();
  if (covariance.rows() != P || covariance.cols() != P ||
      !covariance.isApprox(covariance.transpose(), 1e-6)) {
    throw std::invalid_argument(
        "ChooseModes: the covariance must be symmetric and of the size of the rig's parameters");
  }
  // A square root of the covariance, taken of the correlations because the variances differ by many
  // orders.
  const Eigen::VectorXd sigma = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd inverse = sigma.unaryExpr([](double s) { return s > 0 ? 1 / s : 0.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(inverse.asDiagonal() * covariance *
                                                             inverse.asDiagonal());
  const Eigen::MatrixXd root = sigma.asDiagonal() * eigen.eigenvectors() *
                               eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();

  const auto N = static_cast<Eigen::Index>(working_points_mm.size());
  Eigen::MatrixXd motion(3 * N, P), rigid(3 * N, 6);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& p : working_points_mm) centre += p / static_cast<double>(N);
  for (Eigen::Index i = 0; i < N; ++i) {
    const Eigen::Vector3d& p = working_points_mm[static_cast<std::size_t>(i)];
    motion.middleRows<3>(3 * i) =
        TriangulationParameterJacobian(rig, rig.left.Project(p),
                                       rig.right.Project(rig.right_from_left * p)) *
        root;
    rigid.block<3, 3>(3 * i, 0).setIdentity();
    rigid.block<3, 3>(3 * i, 3) = Skew(p - centre);
  }
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(rigid);
  const Eigen::MatrixXd Q = qr.householderQ() * Eigen::MatrixXd::Identity(3 * N, 6);
  const Eigen::MatrixXd shape = motion - Q * (Q.transpose() * motion);

  CalibrationModes out;
  out.has_scale_mode = scale_sigma > 0;
  const double motion_total = motion.squaredNorm();
  const double shape_total = shape.squaredNorm();
  Eigen::MatrixXd basis = Eigen::MatrixXd::Identity(P, P);
  Eigen::Index kept = 0;
  if (motion_total > 0 && shape_total > 0) {
    const Eigen::MatrixXd both =
        motion.transpose() * motion / motion_total + shape.transpose() * shape / shape_total;
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> ordered(both);
    basis = ordered.eigenvectors().rowwise().reverse();
    double motion_held = 0, shape_held = 0;
    while (kept < P && (motion_held < share * motion_total || shape_held < share * shape_total)) {
      motion_held += (motion * basis.col(kept)).squaredNorm();
      shape_held += (shape * basis.col(kept)).squaredNorm();
      ++kept;
    }
  }
  out.modes.resize(kept + (out.has_scale_mode ? 1 : 0), P);
  out.modes.topRows(kept) = (root * basis.leftCols(kept)).transpose();
  if (out.has_scale_mode) {
    out.modes.bottomRows<1>().setZero();
    out.modes.bottomRightCorner<1, 3>() =
        scale_sigma * rig.right_from_left.translation_mm.transpose();
  }
  return out;
}

}  // namespace plumbline
