#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>

#include "calib/image.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// Which way is down, from the shape of a loaded tyre where no part of it is flat.
//
// Over level ground, or an obstacle that is the same before and behind the axis (a bar along the
// way), a tyre's shape is symmetric about the plane through its axis that is upright to the ground.
// An undeformed wheel is symmetric about every plane through its axis: what tells is the
// deformation. Real tyres lean a little (rolling resistance moves the load ahead, braking shears
// the carcass), so that this is weaker than a plane and has a sigma of its own for what is not
// symmetric.
struct SymmetryOptions {
  double max_asymmetry_mm = 0.3;  // rms of the odd part: more, and there is no symmetry
  // Of the surface below the axis over that before and behind it. A bar across the way is its own
  // plane of symmetry, and nearly the wheel's for the moment in which it is below the axis.
  double max_rise_mm = 3;
  double max_sigma_rad = 0.005;        // an angle less sure is none
  double least_half_angle_rad = 0.12;  // of what is seen on both sides
  double max_tilt_rad = 0.2;           // of the ground's normal from `start_rad`
  double correlation_area_points = 1;  // as in GroundPlaneOptions

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct DeformationSymmetry {
  // Pitch of the ground against the rig, as RigPose has it (track/rig_rotation.h): the angle about
  // the axis from the wheel frame's z at wheel angle 0 to the ground's normal.
  double pitch_rad = 0;
  double sigma_noise_rad = 0;
  double sigma_asymmetry_rad = 0;  // of what the asymmetry that is seen may have done to the angle
  double asymmetry_mm = 0;         // rms of the odd part
  double half_angle_rad = 0;       // seen on both sides
};

// In cylinder coordinates about the axis, angle a from the plane and place y along the axis, the
// radii of the points are fitted by least squares over the plane's angle and the coefficients of
//   r(a, y) = sum c_ij P_2i(a) P_j(y),   P Legendre's polynomials, i <= 5, j <= 12,
// over as much as is seen on both sides. What is left is fitted by odd P (1 to 9) in a, j <= 2: the
// asymmetry. It counts against the angle as if all of it were a turn of the symmetric shape.
//
// point_mm: the inner surface, rig frame, NaN where there is none; sigma_mm: of the points along
// the radius, from noise. start_rad: about where the pitch is, 0 for a rig that looks straight
// down. Nothing where the shape is not symmetric or not deformed; the reason is then in *why, if
// given. Throws UsageError from the options. Accuracy: tests/fit/deformation_symmetry_test.cc.
[[nodiscard]] std::optional<DeformationSymmetry> FindSymmetry(
    const Image<Eigen::Vector3d>& point_mm, double sigma_mm, const WheelAxis& axis,
    double start_rad, const SymmetryOptions& options = {}, std::string* why = nullptr);

}  // namespace plumbline
