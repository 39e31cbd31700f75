#pragma once

#include <Eigen/Core>
#include <span>

#include "calib/rigid3.h"

namespace plumbline {

// Where a wheel turns, seen from a rig that stands still; and the wheel frame.
//
// Wheel frame: y along the axis, so that a positive angle turns z towards x (a wheel that rolls
// towards x, with y to its left). The origin is the point of the axis that is nearest to the left
// camera; at angle 0 the camera lies at (0, 0, -distance_mm), so that z points up where the camera
// looks at the ground. Four numbers, the axis' own degrees of freedom, hold both:
//   point_in_rig = rotation (Ry(angle) point_in_wheel + distance_mm e_z).
struct WheelAxis {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  // rig_from_wheel: its columns in the rig
  double distance_mm = 0;                                  // of the left camera from the axis

  Eigen::Vector3d direction_in_rig() const { return rotation.col(1); }
  Eigen::Vector3d origin_in_rig_mm() const { return distance_mm * rotation.col(2); }
  Rigid3 RigFromWheel(double angle_rad) const;
  // Off by a rotation about the wheel's x, y, z (rad; rotation <- rotation exp(it)) and a distance
  // (mm): the order of all covariances and modes of an axis.
  WheelAxis Off(const Eigen::Vector4d& by) const;

  // The axis through a point of the rig frame. Throws InputError where it goes through the left
  // camera (within 0.1 mm), which says nothing of where z is.
  static WheelAxis Through(const Eigen::Vector3d& point_in_rig_mm,
                           const Eigen::Vector3d& direction_in_rig);
};

// Ry(angle), and with dR its derivative.
Eigen::Matrix3d TurnAboutY(double angle_rad, Eigen::Matrix3d* dR = nullptr);

// The common axis of motions of the wheel, later = turn * earlier, in the rig frame: its direction
// from their rotation vectors, a point on it from sum |(R - 1) point + t|^2, both by least squares,
// larger turns having more to say. Most turns are positive about it. Throws InputError where there
// is no motion or all of them together turn by less than 0.01 rad.
[[nodiscard]] WheelAxis AxisOfTurns(std::span<const Rigid3> turns);

// The part of a motion's rotation that is about the axis, -pi to pi.
[[nodiscard]] double AngleAbout(const WheelAxis& axis, const Rigid3& turn);

}  // namespace plumbline
