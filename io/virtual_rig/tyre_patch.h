#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "io/virtual_rig/tyre_surface.h"

namespace plumbline {

// The contact patch of one moment, in the ground frame (mm).
struct TyrePatch {
  double area_mm2 = 0;
  double length_mm = 0;  // extent along x
  double width_mm = 0;   // extent along y
  Eigen::Vector2d centroid_mm{0, 0};
  // Closed outlines, the patch to their left; holes run the other way round.
  std::vector<std::vector<Eigen::Vector2d>> contours_mm;
};

// Where the tyre touches the ground (threshold_mm = 0), or where it is at most so far above it.
// Nothing where it does not.
//
// Outlines by marching squares over material cells of spacing_mm, each crossing found to 1e-7 mm;
// area and centroid of the outlines by Green's theorem. Accuracy:
// tests/io/virtual_rig/tyre_patch_test.cc.
std::optional<TyrePatch> FindPatch(const TyreSurface& tyre, double time_s, double threshold_mm = 0,
                                   double spacing_mm = 1);

}  // namespace plumbline
