#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <string>

#include "calib/image.h"
#include "fit/surface_points.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// How the loaded wheel differs from the undeformed one.

// A frame of the wheel, in the rig frame.
struct LoadedWheel {
  SurfacePoints loaded;
  // The same material in the undeformed state, turned to the wheel angle of the frame: places with
  // their own errors. Modes as those of `loaded`; none of both, and no errors in common.
  SurfacePoints undeformed;
  double sigma_angle_rad = 0;  // random, of the wheel angle: it turns all of `undeformed`
  WheelAxis axis;
  // Rotation about the wheel's x, y, z (rad; rotation <- rotation exp(it)) and distance (mm).
  Eigen::Matrix4d cov_axis_random = Eigen::Matrix4d::Zero();
  Eigen::MatrixXd axis_along_modes;  // (modes, 4); empty: unknown
  UncertainFrame ground;             // frame_from_rig is ground_from_rig
  Image<std::uint8_t> contact;       // 1: touches the ground
};

struct WheelDeformationOptions {
  double centre_y_mm = 0;  // of the wheel's middle plane, along the axis (wheel frame)
  // Surfaces are read off at a place by a paraboloid through the points so near to it.
  double radius_mm = 25;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct WheelDeformation {
  // Displacement of the material in the ground's axes, with all of its errors.
  SurfacePoints displacement_mm;

  // From the wheel's centre (the axis at centre_y_mm) to the ground plane, along the wheel's plane
  // (ISO 8855). NaN where the axis stands upright.
  MeasuredScalar loaded_radius_mm;
  // Of the inner surface under the wheel's centre, straight up: height of the loaded less that of
  // the undeformed surface at the same x and y. The outer surface's is the same where the
  // thickness of the carcass is.
  MeasuredScalar deflection_mm;
  // How far the carcass is shifted along the wheel's heading and to its left: the mean over the
  // contact patch (by area in the ground plane), and in its centre (centroid of the contact).
  MeasuredScalar longitudinal_mm, lateral_mm;
  MeasuredScalar longitudinal_centre_mm, lateral_centre_mm;
  // The largest approach to the axis, radius of the undeformed less that of the loaded material,
  // and where (loaded, ground frame).
  MeasuredScalar radial_mm;
  Eigen::Vector3d radial_at_mm = Eigen::Vector3d::Zero();

  std::string problem;  // what is NaN and why, in sentences; empty: nothing is
};

// Deformation against the undeformed wheel.
//
// A surface is read off at a place by the least-squares paraboloid of its points within radius_mm,
// about as wrong as the fourth derivative times radius^4 / 100; not where they do not lie all
// around it or are fewer than ten. The largest radial approach is the largest such value about a
// point of the grid.
//
// Errors: random, of the points with what neighbours have in common, of wheel angle, axis and
// ground frame; and along each mode, which moves both surfaces, axis and ground frame at once. To
// first order, with weights and places held.
//
// Throws UsageError from the options, std::invalid_argument where sizes or modes differ.
// Accuracy: tests/track/wheel_deformation_test.cc.
[[nodiscard]] WheelDeformation MeasureDeformation(const LoadedWheel& wheel,
                                                  const NeighbourCorrelation& neighbours,
                                                  const WheelDeformationOptions& options = {});

}  // namespace plumbline
