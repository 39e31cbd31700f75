#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <span>
#include <vector>

#include "fit/wheel_axis.h"
#include "track/wheel_reference.h"
#include "track/wheel_tags.h"

namespace plumbline {

// The rigid angle of a wheel from tags on its rim, and what the surface-drawn angles of a tyre
// (FindRollingAngles) are off it: the twist of the carcass.

// The angle at which the tags of one frame are seen where they are. Random errors are those of
// corners of 1 px; see HoldToRim().
struct RimAngle {
  bool found = false;
  double angle_rad = std::numeric_limits<double>::quiet_NaN();
  double sigma_per_px_rad = 0;     // one standard deviation a px of the corners' coordinates
  double squares_px2 = 0;          // of the residuals
  int freedoms = 0;                // of them
  double sigma_reference_rad = 0;  // from the corners' places on the wheel
  Eigen::VectorXd along_modes_rad;
};

// Where the corners of a tag are seen, and how that changes.
struct TagProjection {
  // Of each corner: left x, left y, right x, right y; px. NaN where a camera does not see it.
  Eigen::Matrix<double, 16, 1> pixels;
  Eigen::Matrix<double, 16, 1> d_angle;    // px / rad
  Eigen::Matrix<double, 16, 12> d_corner;  // px / mm, corners x y z each
};
[[nodiscard]] TagProjection ProjectTag(const StereoRig& rig, const WheelAxis& axis,
                                       const std::array<Eigen::Vector3d, 4>& corner_mm,
                                       double angle_rad);

// Finds the angles of frames. One unknown a frame, by Gauss-Newton over the reprojection of all
// corners in both images,
//   min sum |pixel - project(axis, angle, corner)|^2,   J = d pixels / d angle,
//   sigma_per_px^2 = 1 / J'J,
//   sigma_reference^2 = sum over tags of a' C a,   a = (J'J)^-1 J' d pixels / d corners,
//   along mode k:  -(J'J)^-1 J' (pixels where rig, axis and corners are off by it, less pixels).
class RimAngleFinder {
 public:
  // Keeps a reference to `wheel`.
  explicit RimAngleFinder(const WheelReference& wheel);

  // From the tags that are on the rim, near an angle. Not found where there is none, or where the
  // corners do not lead to an angle.
  [[nodiscard]] RimAngle Find(const StereoTags& seen, double near_rad) const;

 private:
  const WheelReference& wheel_;
  std::vector<StereoRig> rigs_along_;  // one a mode
  std::vector<WheelAxis> axes_along_;
};

// How far the carcass is turned against the rim: the angle that the surface tells, less that of the
// rim. Positive where the surface under the rig is ahead.
struct CarcassTwist {
  bool known = false;
  double angle_rad = std::numeric_limits<double>::quiet_NaN();  // mean over the frames
  double sigma_random_rad = 0;  // noise, and the tags' places on the wheel
  double sigma_calibration_rad = 0;
  double corner_sigma_px = 0;  // of the tags' corners, from the residuals of all frames
  int frames = 0;              // that see a tag on the rim
  bool steady = true;          // the same in all of them, as far as noise tells
};

// The wheel's angles in all frames, from those of the surface and those of the rim.
//
// Steady twist (chi-squared of psi - rho - twist, psi of the surface, rho of the rim, is less than
// four sigmas above what noise lets expect): the angles are psi - twist. They follow the
// surface, which tells turns from frame to frame a thousand times better than a tag does, and are
// the rim's in the mean. Where the twist changes, the angle of a frame that sees a rim tag is rho;
// that of another psi - twist, with how much the twist changes in its sigma.
//
// common: what all angles are off together: the sigma of the twist. Modes go through as the values
// do.
struct AnglesOfRim {
  CarcassTwist twist;
  std::vector<double> angles_rad, sigmas_rad;  // NaN where the surface tells none
  Eigen::MatrixXd along_modes_rad;             // (K, frames)
  double sigma_common_rad = 0;
};

// All of as many frames; a frame without tags on the rim is one that is not found. surface_along:
// (K, frames), or empty. Not known, and the angles as they were, where no frame has both. Throws
// std::invalid_argument where sizes do not fit.
// Accuracy: tests/track/rim_angles_test.cc.
[[nodiscard]] AnglesOfRim HoldToRim(std::span<const double> surface_rad,
                                    std::span<const double> surface_sigma_rad,
                                    const Eigen::MatrixXd& surface_along,
                                    std::span<const RimAngle> rim);

}  // namespace plumbline
