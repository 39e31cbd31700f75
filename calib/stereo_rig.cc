#include "calib/stereo_rig.h"

#include <stdexcept>

namespace plumbline {

int StereoRig::ParameterCount() const {
  return left.parameter_count() + right.parameter_count() + 6;
}

Eigen::VectorXd StereoRig::Parameters() const {
  Eigen::VectorXd p(ParameterCount());
  p << left.parameters(), right.parameters(), right_from_left.RotationVector(),
      right_from_left.translation_mm;
  return p;
}

StereoRig StereoRig::WithParameters(const Eigen::VectorXd& parameters) const {
  if (parameters.size() != ParameterCount()) {
    throw std::invalid_argument("StereoRig::WithParameters: wrong number of parameters");
  }
  StereoRig rig = *this;
  const int n_left = left.parameter_count();
  const int n_right = right.parameter_count();
  rig.left = left.WithParameters(parameters.head(n_left));
  rig.right = right.WithParameters(parameters.segment(n_left, n_right));
  rig.right_from_left =
      Rigid3::FromRotationVector(parameters.segment<3>(n_left + n_right), parameters.tail<3>());
  return rig;
}

StereoRig StereoRig::AlongMode(int k, double amount) const {
  return WithParameters(Parameters() + amount * modes.modes.row(k).transpose());
}

Eigen::MatrixXd CalibrationCovariance(const StereoRig& rig,
                                      const std::function<Eigen::VectorXd(const StereoRig&)>& g) {
  const Eigen::VectorXd nominal = g(rig);
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(nominal.size(), nominal.size());
  for (int k = 0; k < rig.modes.count(); ++k) {
    const Eigen::VectorXd difference = g(rig.AlongMode(k)) - nominal;
    covariance += difference * difference.transpose();
  }
  return covariance;
}

}  // namespace plumbline
