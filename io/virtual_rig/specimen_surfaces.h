#pragma once

#include <Eigen/Core>
#include <memory>

#include "calib/rigid3.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// Flat and curved specimens of the laboratory, size_mm wide (u) and high (v), centred on (0, 0).
// Material coordinates are those of the flat sheet; at time 0 and without rigid motion it lies in
// the plane z = 0 of the world frame with u along x and v along y.
struct SpecimenOptions {
  Eigen::Vector2d size_mm{120, 90};

  // How it is made.
  enum class Shape { kPlane, kIncline, kCylinder } shape = Shape::kPlane;
  double incline_rad = 0.1745329;  // kIncline: a wedge that rises from the line u = 0 towards +u
  double crease_mm = 2;            // half width over which the crease of the wedge is rounded
  double cylinder_radius_mm = 60;  // kCylinder: axis along y below the sheet, arc length kept

  // How it deforms: all linear in time, reached in full at end_time_s.
  double end_time_s = 1;
  // In-plane deformation gradient minus one: (xx, xy; yx, yy).
  Eigen::Matrix2d displacement_gradient = Eigen::Matrix2d::Zero();
  // The star pattern: a displacement along v of this amplitude whose period in v grows along u from
  // star_period_min_mm at the left edge to star_period_max_mm at the right one.
  double star_amplitude_mm = 0;
  double star_period_min_mm = 1;
  double star_period_max_mm = 20;
  // Rigid motion about the world's origin, after the deformation.
  Eigen::Vector3d rotation_rad = Eigen::Vector3d::Zero();  // rotation vector
  Eigen::Vector3d translation_mm = Eigen::Vector3d::Zero();

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

std::unique_ptr<const MaterialSurface> MakeSpecimen(const SpecimenOptions& options);

}  // namespace plumbline
