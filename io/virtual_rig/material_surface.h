#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>
#include <memory>

namespace plumbline {

// Where a material point is at one moment.
//
// Material coordinates (u, v) are millimetres on the surface as it was made; they stay with the
// material while it moves and deforms.
struct SurfacePoint {
  Eigen::Vector3d position_mm;                        // world frame
  Eigen::Matrix<double, 3, 2> d_position_d_material;  // mm / mm; the columns are along u and v

  // Unit normal on the side that is meant to be seen: (d/du) x (d/dv).
  Eigen::Vector3d Normal() const {
    return d_position_d_material.col(0).cross(d_position_d_material.col(1)).normalized();
  }
};

// The part of the material plane that there is. Periodic surfaces close in u: u and u + period_u
// are the same material.
struct MaterialDomain {
  double u_min = 0, u_max = 0, v_min = 0, v_max = 0;
  double period_u = std::numeric_limits<double>::infinity();
};

// A surface at one moment.
class SurfaceInstant {
 public:
  virtual ~SurfaceInstant() = default;

  // Exact position and tangents. Defined beyond the domain too, smoothly, so that a search for the
  // material under a pixel does not fall off an edge.
  virtual SurfacePoint At(const Eigen::Vector2d& material_mm) const = 0;

  // Velocity of the material point in the world frame (mm/s): the exact derivative of its position
  // by time.
  virtual Eigen::Vector3d Velocity(const Eigen::Vector2d& material_mm) const = 0;

  // Where cameras may see the surface: the window over which it is searched for a pixel. At most
  // one period wide.
  virtual MaterialDomain Window() const = 0;
};

// A surface in motion: a smooth mapping (u, v, t) -> space, from which shape, displacement,
// deformation gradient, strain and velocity follow exactly by differentiation.
//
// World frame: that of the scenario (`ground`: z up, x the direction of travel, y to the left).
// Immutable and thread-safe.
class MaterialSurface {
 public:
  virtual ~MaterialSurface() = default;

  virtual MaterialDomain Domain() const = 0;

  virtual std::unique_ptr<const SurfaceInstant> At(double time_s) const = 0;

  // The undeformed state that displacement and strain at time_s count from. For specimens the state
  // of time 0; for the tyre the unloaded wheel, turned by the wheel angle of that time.
  virtual std::unique_ptr<const SurfaceInstant> Reference(double time_s) const = 0;
};

// Green-Lagrange strain E = (F'F - 1) / 2 of the surface from `reference` to `deformed` (both of
// the same material point), as (xx, yy, xy) in the material axes: x along the reference's d/du, y
// perpendicular to it in the tangent plane, towards v.
Eigen::Vector3d GreenLagrangeStrain(const SurfacePoint& reference, const SurfacePoint& deformed);

}  // namespace plumbline
