#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "calib/internal/board_discs.h"
#include "calib/internal/detect_families.h"

namespace plumbline::internal {
namespace {

// Lattice places of the candidates that look like rings.
std::vector<GridPlace> Rings(const DotLattice& lattice) {
  std::vector<GridPlace> rings;
  for (const auto& [place, index] : lattice.grid.points) {
    if (lattice.candidates.dots[static_cast<std::size_t>(index)].ring) rings.push_back(place);
  }
  return rings;
}

GridPlace PlaceOf(const BoardSpec& spec, int id) { return {id % spec.columns, id / spec.columns}; }

// Every pose in which all three markers fall on rings.
std::vector<GridPose> PosesFromRings(const BoardSpec& spec, const std::vector<GridPlace>& rings) {
  const DonutMarkers markers = MarkersOf(spec);
  const GridPlace origin = PlaceOf(spec, markers.origin);
  std::vector<GridPose> poses;
  for (int turns = 0; turns < 4; ++turns) {
    for (const GridPlace& ring : rings) {
      GridPose pose{turns, 0, 0};
      const GridPlace at = pose.Turned(ring);
      pose.column0 = at.first - origin.first;
      pose.row0 = at.second - origin.second;
      const auto on_ring = [&](int id) {
        return std::any_of(rings.begin(), rings.end(), [&](const GridPlace& r) {
          return pose.BoardPlace(r) == PlaceOf(spec, id);
        });
      };
      if (on_ring(markers.along_x) && on_ring(markers.along_y)) poses.push_back(pose);
    }
  }
  return poses;
}

// The board word whose markers would fit three rings that form a corner, if they do.
std::string BoardOfRings(const BoardSpec& spec, const std::vector<GridPlace>& rings) {
  if (rings.size() != 3) return "";
  for (std::size_t o = 0; o < 3; ++o) {
    const GridPlace origin = rings[o], p = rings[(o + 1) % 3], q = rings[(o + 2) % 3];
    for (const auto& [x, y] : {std::pair{p, q}, std::pair{q, p}}) {
      // Turned by quarters until the x marker is to the right of the origin.
      GridPlace to_x{x.first - origin.first, x.second - origin.second};
      GridPlace to_y{y.first - origin.first, y.second - origin.second};
      for (int k = 0; k < 4 && !(to_x.first > 0 && to_x.second == 0); ++k) {
        to_x = {-to_x.second, to_x.first};
        to_y = {-to_y.second, to_y.first};
      }
      if (to_x.first <= 0 || to_x.second != 0 || to_y.first != 0 || to_y.second >= 0) continue;
      BoardSpec other = spec;
      other.columns = to_x.first + 5;
      other.rows = 5 - to_y.second;
      return fmt::format("{}x{}", other.columns, other.rows);
    }
  }
  return "";
}

std::string WhyNoPose(const BoardSpec& spec, const DotLattice& lattice,
                      const std::vector<GridPlace>& rings, ImageSize size) {
  if (lattice.grid.points.size() < 9) {
    return fmt::format(
        "too few dots: {} dot-like blobs, {} of them in a grid; is the board in view and sharp?",
        lattice.candidates.dots.size(), lattice.grid.points.size());
  }
  const std::string board = BoardOfRings(spec, rings);
  if (!board.empty()) {
    return fmt::format("the three rings fit a board of {} dots, not {}x{}; check the board word",
                       board, spec.columns, spec.rows);
  }
  if (rings.size() < 3) {
    return fmt::format("{} of 3 ring markers found among {} dots{}", rings.size(),
                       lattice.grid.points.size(),
                       ReachesImageEdge(lattice, size)
                           ? "; the board is cut off by the image's edge, keep all three rings in "
                             "view"
                           : "; covered, in glare or too blurred?");
  }
  return fmt::format("{} rings among {} dots, but no three of them lie as the markers of {} do",
                     rings.size(), lattice.grid.points.size(), spec.Word());
}

}  // namespace

BoardDetection DetectDonutDots(const BoardSpec& spec, const GrayImage& image) {
  const DotLattice lattice = FindDotLattice(image, spec, 2.5);
  const auto rings = Rings(lattice);
  const auto poses = PosesFromRings(spec, rings);
  if (poses.empty()) return NotFound(WhyNoPose(spec, lattice, rings, image.size()));
  if (poses.size() > 1) {
    return NotFound(fmt::format("{} rings fit the three markers in {} ways; which is the board?",
                                rings.size(), poses.size()));
  }
  std::map<int, int> candidate_of_id;
  int beyond = 0;
  for (const auto& [place, index] : lattice.grid.points) {
    const auto [c, r] = poses[0].BoardPlace(place);
    if (c < 0 || r < 0 || c >= spec.columns || r >= spec.rows) {
      ++beyond;
    } else {
      candidate_of_id[r * spec.columns + c] = index;
    }
  }
  if (beyond >= std::min(spec.columns, spec.rows) / 2) {
    const auto [a, b] = Extent(lattice.grid);
    return NotFound(
        fmt::format("{} dots lie beyond the edge of {} (the grid in the photograph is "
                    "{}x{}); check the board word",
                    beyond, spec.Word(), std::max(a, b), std::min(a, b)));
  }
  BoardDetection out = FitBoardDiscs(spec, image, lattice, candidate_of_id);
  if (out.ids.size() < 9) {
    return NotFound(fmt::format("only {} of {} dots could be fitted; too blurred or too small?",
                                out.ids.size(), candidate_of_id.size()));
  }
  return out;
}

}  // namespace plumbline::internal
