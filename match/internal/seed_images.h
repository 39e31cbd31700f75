#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string_view>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// A pair, halved so many times. Pixel (x, y) lies at (factor x, factor y) of the full images.
struct SeedLevel {
  int factor = 1;
  Image<float> reference, deformed;  // grey levels of 8 bits
  Image<std::uint8_t> mask;          // of the reference: 1 where it may be used
};

// Throws InputError, naming what was attempted, when the images or the mask differ in size or a
// subset of this side does not fit into them.
void CheckSeedInput(std::string_view what, const GrayImage& reference, const GrayImage& deformed,
                    const Image<std::uint8_t>* mask, int subset_px);

// Grey levels divided by 2^(bits - 8).
Image<float> ToFloat8(const GrayImage& image);

// Level 0 at full resolution, then halved (Gaussian pyramid) while the longer side is over
// longest_px and the shorter one stays at shortest_px or above.
std::vector<SeedLevel> BuildSeedLevels(const GrayImage& reference, const GrayImage& deformed,
                                       const Image<std::uint8_t>* mask, int longest_px,
                                       int shortest_px);

// One pixel of each cell of a lattice: of those with mask != 0 and at least margin_px from the
// border, the one nearest their centroid. Row by row; cells without one are left out.
std::vector<Eigen::Vector2i> SeedLattice(const Image<std::uint8_t>& mask, int spacing_px,
                                         int margin_px);

}  // namespace plumbline::internal
