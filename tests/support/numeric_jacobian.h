#pragma once

#include <Eigen/Core>
#include <cmath>
#include <functional>

namespace plumbline::testing {

// The Jacobian of f at x by central differences with a relative step, fourth order (Fornberg 1988,
// weights 1/12, -2/3).
inline Eigen::MatrixXd NumericJacobian(
    const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& f, const Eigen::VectorXd& x,
    double relative_step = 1e-4) {
  Eigen::MatrixXd J(f(x).size(), x.size());
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    const double h = relative_step * std::max(1.0, std::abs(x[i]));
    const auto at = [&](double k) {
      Eigen::VectorXd y = x;
      y[i] += k * h;
      return f(y);
    };
    J.col(i) = (at(-2) - 8 * at(-1) + 8 * at(1) - at(2)) / (12 * h);
  }
  return J;
}

}  // namespace plumbline::testing
