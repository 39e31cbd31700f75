#pragma once

#include <cstdint>
#include <memory>

#include "io/virtual_rig/albedo.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// A sprayed speckle: discs of random place and size on a bright ground.
struct SpeckleOptions {
  double diameter_mm = 1;        // mean of the discs
  double diameter_spread = 0.3;  // uniform, +- this share of the mean
  double coverage = 0.5;         // share of the ground that the discs would cover without overlap
  double edge = 0.4;             // width of a disc's soft edge as a share of its radius
  double black = 0.08, white = 0.85;  // albedo
  double background = 0.25;           // beyond the edge of the material
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The speckle of a material domain; where that is periodic in u, so is the speckle.
//
// Albedo: white * prod_k (1 - c_k) + black * (1 - prod_k (1 - c_k)), c_k the coverage by disc k:
//   c = S((b^2 - r^2) / (b^2 - a^2)),  a, b = radius * (1 -+ edge / 2),  S(x) = x^2 (3 - 2 x).
// Exact at every point; memory about 200 bytes a disc. Throws UsageError where discs are too large
// or too many for the domain.
std::unique_ptr<const Albedo> MakeSpeckle(const MaterialDomain& domain,
                                          const SpeckleOptions& options);

}  // namespace plumbline
