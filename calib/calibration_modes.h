#pragma once

#include <Eigen/Core>
#include <span>

#include "calib/stereo_rig.h"

namespace plumbline {

// Turns the covariance of a rig's parameters into calibration modes.
//
// The modes are ordered by what they do to `working_points_mm` (rig frame, seen by both cameras),
// and as many are kept as hold `share` of the summed variance of those points, both as they stand
// in the rig frame and with the rigid motion that fits best taken out (the rigid motion is by far
// the larger, and no result depends on it). With scale_sigma > 0 (relative) a last mode scales the
// translation.
//
// covariance: (P, P), order of StereoRig::Parameters. Throws std::invalid_argument where it is not
// symmetric or of another size.
CalibrationModes ChooseModes(const StereoRig& rig, const Eigen::MatrixXd& covariance,
                             double scale_sigma, std::span<const Eigen::Vector3d> working_points_mm,
                             double share = 0.999);

}  // namespace plumbline
