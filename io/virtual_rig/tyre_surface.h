#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// The undeformed cross-section of a tyre's inner surface, by its curvature: a flat crown, tight
// shoulders, round sidewalls; and the thickness of the carcass over it.
struct TyreSection {
  double crown_radius_mm = 384;  // of the inner surface, from the wheel axis
  // Curvature (1/mm) of crown, shoulder and sidewall, and the arc lengths from the crown's centre
  // at which one turns into the next, over blend_mm.
  double crown_curvature = 1.0 / 300, shoulder_curvature = 1.0 / 46, sidewall_curvature = 1.0 / 110;
  double shoulder_begin_mm = 62, sidewall_begin_mm = 104, blend_mm = 24;
  double half_length_mm = 215;  // from the crown's centre to the bead
  double crown_thickness_mm = 20, shoulder_thickness_mm = 22, sidewall_thickness_mm = 9;
};

// What lies on the flat ground. Coordinates (X, Y) are fixed to the ground: X the way ahead of the
// wheel axis at time 0, Y to the left of the wheel plane; heights above the ground (mm).
struct Obstacle {
  enum class Section {
    kSquare,     // a bar of square section, lying flat: size_mm is its side
    kAngleIron,  // an equal angle iron lying on its hypotenuse, ridge up: size_mm is its leg
    kNut         // a hexagonal nut, lying flat: size_mm across flats, height_mm high
  };
  Section section = Section::kSquare;
  double size_mm = 38;
  double height_mm = 0;  // kNut only
  // Centre of the obstacle; bars go through it without end, at this angle of their length against
  // the Y axis (0: across the way, 90 degrees: along it).
  Eigen::Vector2d centre_mm{0, 0};
  double angle_rad = 0;

  double Height() const;  // of the top
};

// A loaded, rolling tyre of which the inner surface is seen. The defaults are a 7.50R16 off-road
// tyre at 2 bar on a Land Rover 110.
struct TyreOptions {
  TyreSection section;
  double deflection_mm = 18;            // of the loaded wheel on flat ground
  double lifted_mm = 0;                 // above 0: the wheel hangs free, so far above the ground
  double free_rolling_radius_mm = 389;  // travel a radian of the wheel at zero slip
  double bending_length_mm = 30;        // of the carcass, over obstacles
  double tread_lift = 0.2;     // share of the deflection by which the tread as a whole moves up
  double contact_edge_mm = 4;  // half height over which the patch's edge is rounded
  std::vector<Obstacle> obstacles;

  double speed_mm_s = 1400;     // mean
  double speed_swing_mm_s = 0;  // of a sinusoidal change of speed, with this period
  double speed_period_s = 1;
  double start_travel_mm = 0;  // way of the wheel axis along X at time 0
  double start_angle_rad = 0;  // wheel angle at time 0
  // ISO 8855: longitudinal slip (omega - omega_0) / omega_0, negative in braking; slip angle from
  // the wheel's heading to the direction of travel, positive to the left (about z).
  double slip_ratio = 0;
  double slip_angle_rad = 0;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// How the wheel stands and turns. Ground frame of the moment: origin on the ground below the wheel
// axis, x the direction of travel, y to the left, z up.
struct WheelState {
  double angle_rad = 0;            // turned since the state at which u = 0 was at the bottom
  double angular_speed_rad_s = 0;  // about +y: rolling forwards
  double centre_height_mm = 0;
  double level_height_mm = 0;  // what that would be on flat ground
  double speed_mm_s = 0;       // of the vehicle, along x
  double acceleration_mm_s2 = 0;
  double travel_mm = 0;
  // How far the loaded tyre is compressed against the mean ground under its footprint; 0 if lifted.
  double compression_mm = 0;
  Eigen::Vector3d axis{0, 1, 0};  // unit, to the left
};

// Where the tyre touches the ground at one moment.
class TyreContact {
 public:
  virtual ~TyreContact() = default;
  // Signed (mm): how far from touching the ground; zero or below in contact. Its size means
  // something near zero only.
  virtual double Level(const Eigen::Vector2d& material_mm) const = 0;
  // Distance of the inner surface from the ground straight below, less the carcass thickness (mm):
  // zero in contact.
  virtual double Gap(const Eigen::Vector2d& material_mm) const = 0;
};

// The kinematics. With s the arc length along the meridian, phi the angle from the bottom (forwards
// positive) and all distances in mm:
//
// - unloaded: a surface of revolution, (r(s) sin phi, y(s), -r(s) cos phi) about the wheel centre;
//   material u = crown radius * (phi + wheel angle), v = s;
// - loaded: the tread moves up with a part of the deflection, the sidewalls bulge, both fading
//   towards the bead and away from the patch;
// - in the patch: height = carcass thickness + envelope of the ground, exactly, by SmoothRamp: no
//   point is ever lower, and where the ramp is at zero the tyre is in contact;
// - along the patch: x = free rolling radius * phi, plus the shear that slip makes. It builds up
//   linearly from the leading edge, so that the material of the stick zone stands still on the
//   ground exactly (its arc length is conserved), and relaxes in a sliding zone at the trailing
//   edge;
// - the axle rises by a part of the mean height of the envelope under the footprint.
//
// It is a kinematic model, not a finite-element one: smooth (two continuous derivatives), plausible
// in size and shape, and exact about its own truth. The carcass follows the tread: shear of the
// tread blocks under slip is part of the carcass's.
class TyreSurface : public MaterialSurface {
 public:
  explicit TyreSurface(const TyreOptions& options);
  ~TyreSurface() override;

  // u closes after one turn: period_u = 2 pi * crown radius.
  MaterialDomain Domain() const override;
  std::unique_ptr<const SurfaceInstant> At(double time_s) const override;

  // The unloaded wheel in the place and angle of time_s.
  std::unique_ptr<const SurfaceInstant> Reference(double time_s) const override;

  WheelState Wheel(double time_s) const;
  double CarcassThickness(double v_mm) const;
  // Height of the ground (of obstacles too) at a place of the ground frame of time_s.
  double GroundHeight(const Eigen::Vector2d& ground_mm, double time_s) const;

  // Nothing where the wheel is lifted.
  std::unique_ptr<const TyreContact> Contact(double time_s) const;

  const TyreOptions& options() const;

 private:
  class Shape;
  class ContactInstant;
  std::shared_ptr<const Shape> loaded_, unloaded_;
};

}  // namespace plumbline
