#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "fit/surface_points.h"

namespace plumbline {

// The plane normal . p = offset_mm that a surface is cut by, and the axes of the drawing in it.
struct CutPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitX();  // unit
  double offset_mm = 0;
  Eigen::Vector3d along = Eigen::Vector3d::UnitY();  // unit, in the plane

  Eigen::Vector3d up() const { return normal.cross(along); }

  // x = x_mm, drawn along y: a lateral section of the ground frame.
  static CutPlane AtX(double x_mm);
  // y = y_mm, drawn along x: a longitudinal one. Both have z upwards.
  static CutPlane AtY(double y_mm);
  // Perpendicular to the ground (z up), through a point of it, drawn along a direction of it (rad
  // from x to y).
  static CutPlane Upright(const Eigen::Vector2d& through_mm, double direction_rad);

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A point of the cut, on the edge of the grid between two neighbouring points of the surface.
struct SectionPoint {
  Eigen::Vector3d position_mm;
  double along_mm = 0, up_mm = 0;  // position . along, position . up
  // Of the distance from the line as measured to the true one, perpendicular to it, in the plane.
  double sigma_random_mm = 0, sigma_calibration_mm = 0;
  // (1 - share) of one point and share of the next; for values at the points' places too.
  std::size_t from = 0, to = 0;
  double share = 0;

  bool gap() const { return !(along_mm == along_mm); }  // all numbers are NaN: parts two pieces
};

// Cuts a surface by a plane.
//
// The line passes between two neighbours a, b of the grid that lie on different sides of the plane,
// where it crosses the straight line that joins them (marching squares, fit/outline.h). Nothing is
// joined over a missing point or beyond the grid: pieces are parted by a gap. Each piece runs
// towards growing `along` (from the end with the smaller one), pieces are ordered by their
// beginning; a closed piece ends with its first point again.
//
// An error e_a, e_b of the points moves the crossing within the plane by
//   (1 - d n' / (n . d)) ((1 - share) e_a + share e_b),   d = p_b - p_a;
// the band is that along the normal of the line, exact to first order, with what neighbours have in
// common. Linear interpolation leaves out at most (curvature) |d|^2 / 8.
//
// Empty where the plane meets no edge. sigma_calibration_mm is NaN where the modes are unknown.
// Throws UsageError from the plane, std::invalid_argument where the sizes differ.
// Accuracy: tests/fit/cross_section_test.cc.
[[nodiscard]] std::vector<SectionPoint> CutSurface(const SurfacePoints& surface,
                                                   const CutPlane& plane,
                                                   const NeighbourCorrelation& neighbours);

}  // namespace plumbline
