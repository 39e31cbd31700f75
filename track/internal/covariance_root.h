#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>

namespace plumbline::internal {

// A root of a covariance that may be singular, and whose entries have several units: columns are
// what one sigma of each independent error does.
inline Eigen::MatrixXd CovarianceRoot(const Eigen::MatrixXd& cov) {
  const Eigen::VectorXd sigma = cov.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd by = (sigma.array() > 0).select(sigma.cwiseInverse(), 0);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(by.asDiagonal() * cov *
                                                              by.asDiagonal());
  return sigma.asDiagonal() * solver.eigenvectors() *
         solver.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

}  // namespace plumbline::internal
