#pragma once

#include <Eigen/Core>
#include <functional>
#include <span>
#include <string>

#include "calib/camera.h"
#include "calib/rigid3.h"

namespace plumbline {

// How a calibration may be wrong, as K independent unit-variance directions in the space of the
// rig's parameters.
//
// Row k is one standard deviation of mode k, in parameter units (see StereoRig::Parameters for
// their order), so that the covariance of the parameters is modes' * modes. Any result g, however
// derived, has the common uncertainty
//   u_cal^2 = sum_k (g(parameters + modes.row(k)) - g(parameters))^2.
// The last row is the board's overall scale alone, where has_scale_mode is set.
struct CalibrationModes {
  Eigen::MatrixXd modes;  // (K, P)
  bool has_scale_mode = false;

  int count() const { return static_cast<int>(modes.rows()); }
};

// Two cameras that stand still against each other. The rig frame is the left camera.
struct StereoRig {
  Camera left;
  Camera right;
  Rigid3 right_from_left;
  CalibrationModes modes;
  std::string board;  // the board SPEC it was calibrated from; empty if read from elsewhere

  // P = left intrinsics, right intrinsics, rotation vector (rad) and translation (mm) of
  // right_from_left.
  int ParameterCount() const;
  Eigen::VectorXd Parameters() const;
  StereoRig WithParameters(const Eigen::VectorXd& parameters) const;

  // This rig moved by `amount` standard deviations along mode k.
  StereoRig AlongMode(int k, double amount = 1.0) const;

  double baseline_mm() const { return right_from_left.translation_mm.norm(); }
};

// Covariance of g (any vector-valued function of the rig) from the calibration modes, by
// re-evaluating g once a mode. Units: those of g, squared. Zero when the rig carries no modes. g
// must be finite at the rig itself.
Eigen::MatrixXd CalibrationCovariance(const StereoRig& rig,
                                      const std::function<Eigen::VectorXd(const StereoRig&)>& g);

}  // namespace plumbline
