#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "fit/surface_points.h"

namespace plumbline {

struct BumpOptions {
  double least_height_mm = 2;     // above its surroundings
  double least_significance = 5;  // height over its sigma
  double top_radius_mm = 6;       // of the points whose mean is the top
  // Clearance up to which surroundings touch the ground; two sigmas of the ground's height where
  // that is known no better (SurfacePoints::along_common_mm).
  double flat_mm = 0.5;
  double ring_mm = 60;  // how far around the area above half of the height they count

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A rise of the surface that is lower all around.
struct Bump {
  std::size_t place = 0;        // of its top: row * columns + column
  Eigen::Vector2d at_mm{0, 0};  // in the ground plane
  MeasuredScalar height_mm;     // of the top above its surroundings
  MeasuredScalar clearance_mm;  // of the top above the ground plane, less the thickness
  double significance = 0;      // height over both of its sigmas together
  double width_mm = 0;          // of a disc as large as what rises above half of the height
  int surroundings = 0;         // points
};

// Local bumps of the inner surface, as over a nut under the tyre, the highest first. No place is
// given beforehand.
//
// The clearance of a point is its height over the ground plane less the thickness of the carcass.
// A bump is a maximum of the clearance's mean over top_radius_mm around which the points above half
// of it are surrounded by lower ones, without a higher maximum and without reaching the end of what
// is seen: where the tyre lifts off it rises too, but comes down nowhere. Of the points a tenth may
// be missing, here and there. Its top is where the
// centre of what rises above three quarters of the maximum lies, not where noise makes it highest,
// and its height is the mean there over top_radius_mm above that of the points around that touch
// the ground: those within 1.5 sigmas of where their clearances lie densest, since others begin to
// hang free. So errors of the plane's height and of a constant thickness cancel. Beside a
// high bump, where little touches the ground, it comes out low by a sigma or two of the points; the
// clearance does not, but has the plane's error. Both are lower than the highest point by about
// (curvature) top_radius^2 / 4.
//
// surface: ground frame, z up. thickness_mm: of the carcass over each point, along z, without
// error.
//
// Throws UsageError from the options, std::invalid_argument where sizes differ.
// Accuracy: tests/fit/bump_test.cc, tests/track/wheel_deformation_test.cc.
[[nodiscard]] std::vector<Bump> FindBumps(const SurfacePoints& surface,
                                          const Image<double>& thickness_mm,
                                          const NeighbourCorrelation& neighbours,
                                          const BumpOptions& options = {});

}  // namespace plumbline
