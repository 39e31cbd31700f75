#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/board.h"
#include "calib/internal/dot_candidates.h"
#include "calib/internal/point_grid.h"

namespace plumbline::internal {

// The dots of a photograph in lattice order.
struct DotLattice {
  DotCandidates candidates;
  std::vector<GridPoint> points;  // of the candidates, in their order
  PointGrid grid;
  bool dark = true;
};

// Black dots on white, or white ones on black, whichever make the larger lattice.
DotLattice FindDotLattice(const GrayImage& image, const BoardSpec& spec, double largest_ratio);

// Columns and rows (or rows and columns) that a lattice spans.
std::pair<int, int> Extent(const PointGrid& grid);

// Whether a dot of the lattice is within one and a half spacings of the image's edge, so that its
// next neighbour may be outside.
bool ReachesImageEdge(const DotLattice& lattice, ImageSize size);

// Fits the dots that were given their ids and puts them into a detection with sigma_px and
// disc_radius_mm. Dots that cannot be fitted are missing there.
BoardDetection FitBoardDiscs(const BoardSpec& spec, const GrayImage& image,
                             const DotLattice& lattice, const std::map<int, int>& candidate_of_id);

}  // namespace plumbline::internal
