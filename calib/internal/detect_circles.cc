#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "calib/internal/board_discs.h"
#include "calib/internal/detect_families.h"

namespace plumbline::internal {
namespace {

// Where a board's points lie in the lattice of their nearest neighbours, turned to the board's
// axes. The nearest neighbours of asymmetric circles are diagonal: lattice directions (p, p) and
// (-p, p).
std::vector<GridPlace> LatticePlaces(const BoardSpec& spec) {
  std::vector<GridPlace> places;
  for (int r = 0; r < spec.rows; ++r) {
    for (int c = 0; c < spec.columns; ++c) {
      if (spec.kind == BoardSpec::Kind::kAsymmetricCircles) {
        const int x = 2 * c + r % 2;
        places.push_back({(x + r) / 2, (r - x) / 2});
      } else {
        places.push_back({c, r});
      }
    }
  }
  return places;
}

// Every way to lay the whole board onto the lattice.
std::vector<GridPose> WholeBoards(const PointGrid& grid, const std::vector<GridPlace>& places) {
  std::vector<GridPose> poses;
  for (int turns = 0; turns < 4; ++turns) {
    GridPose pose{turns, 0, 0};
    PointGrid turned;
    for (const auto& [place, index] : grid.points) turned.points[pose.Turned(place)] = index;
    for (const auto& [first, index] : turned.points) {
      pose.column0 = first.first - places[0].first;
      pose.row0 = first.second - places[0].second;
      const bool whole = std::all_of(places.begin(), places.end(), [&](const GridPlace& place) {
        return turned.Has({place.first + pose.column0, place.second + pose.row0});
      });
      if (whole) poses.push_back(pose);
    }
  }
  return poses;
}

std::map<int, int> CandidateOfId(const PointGrid& grid, const std::vector<GridPlace>& places,
                                 const GridPose& pose) {
  std::map<GridPlace, int> id_of_place;
  for (std::size_t id = 0; id < places.size(); ++id) id_of_place[places[id]] = static_cast<int>(id);
  std::map<int, int> out;
  for (const auto& [place, index] : grid.points) {
    const auto id = id_of_place.find(pose.BoardPlace(place));
    if (id != id_of_place.end()) out[id->second] = index;
  }
  return out;
}

// The one disc with at least twice the area of the others, or -1.
int BigDot(const DotLattice& lattice, const std::map<int, int>& candidate_of_id) {
  std::vector<std::pair<double, int>> sizes;
  for (const auto& [id, index] : candidate_of_id) {
    sizes.push_back({lattice.points[static_cast<std::size_t>(index)].size, id});
  }
  std::sort(sizes.begin(), sizes.end());
  const double median = sizes[sizes.size() / 2].first;
  const bool one = sizes.back().first > 2 * median && sizes[sizes.size() - 2].first < 1.6 * median;
  return one ? sizes.back().second : -1;
}

std::string WhyNotWhole(const BoardSpec& spec, const DotLattice& lattice, ImageSize size) {
  const auto n = lattice.grid.points.size();
  if (n < 4) {
    return fmt::format(
        "no grid of dots: {} dot-like blobs in the photograph, no four of them in a grid; is the "
        "board in view, sharp and of even light?",
        lattice.candidates.dots.size());
  }
  if (spec.kind == BoardSpec::Kind::kAsymmetricCircles) {
    return fmt::format("{} discs in a grid where {} has {}{}", n, spec.Word(), spec.PointCount(),
                       ReachesImageEdge(lattice, size)
                           ? "; the board is cut off by the image's edge"
                           : "; check the board word, and that no disc is covered");
  }
  const auto [a, b] = Extent(lattice.grid);
  const bool smaller = std::max(a, b) < std::max(spec.columns, spec.rows) ||
                       std::min(a, b) < std::min(spec.columns, spec.rows);
  const std::string seen =
      fmt::format("found a grid of {}x{} discs ({} seen) where {}x{} was asked", std::max(a, b),
                  std::min(a, b), n, spec.columns, spec.rows);
  if (smaller && ReachesImageEdge(lattice, size)) {
    return seen + "; the board is cut off by the image's edge";
  }
  if (n == static_cast<std::size_t>(a) * static_cast<std::size_t>(b)) {
    return seen + "; check the board word";
  }
  return seen + "; some discs are covered, in glare or too blurred";
}

}  // namespace

BoardDetection DetectCircles(const BoardSpec& spec, const GrayImage& image) {
  const DotLattice lattice = FindDotLattice(image, spec, 7);
  const auto places = LatticePlaces(spec);
  std::vector<GridPose> poses = WholeBoards(lattice.grid, places);
  if (poses.empty()) return NotFound(WhyNotWhole(spec, lattice, image.size()));
  const auto expected = static_cast<std::size_t>(spec.SymmetryOrder());
  if (poses.size() > expected) {
    return NotFound(fmt::format(
        "the photograph shows more discs in a grid ({}) than {} has; check the board word",
        lattice.grid.points.size(), spec.Word()));
  }
  if (spec.kind == BoardSpec::Kind::kCircles) {
    // A big disc marks the bottom left corner.
    std::vector<GridPose> marked;
    for (const GridPose& pose : poses) {
      const int corner = (spec.rows - 1) * spec.columns;
      if (BigDot(lattice, CandidateOfId(lattice.grid, places, pose)) == corner) {
        marked.push_back(pose);
      }
    }
    if (!marked.empty()) poses = marked;
  }
  std::vector<double> angles;
  for (const GridPose& pose : poses) {
    double angle = ColumnAngle(lattice.grid, lattice.points, pose);
    // The lattice's first direction runs diagonally on an asymmetric board.
    if (spec.kind == BoardSpec::Kind::kAsymmetricCircles) angle -= std::numbers::pi / 4;
    angles.push_back(std::remainder(angle, 2 * std::numbers::pi));
  }
  const int chosen = NearestToImageAxes(angles);
  if (chosen < 0) {
    return NotFound(fmt::format(
        "{} looks the same when turned, and its rows are too far from the image's rows here to "
        "tell "
        "which way round it is; hold it with its rows along the image's, or use a board with "
        "markers",
        spec.Word()));
  }
  const auto candidate_of_id =
      CandidateOfId(lattice.grid, places, poses[static_cast<std::size_t>(chosen)]);
  BoardDetection out = FitBoardDiscs(spec, image, lattice, candidate_of_id);
  if (out.ids.size() != candidate_of_id.size()) {
    return NotFound(fmt::format(
        "{} of {} discs could not be fitted: cut off by the image's edge, covered or too blurred",
        candidate_of_id.size() - out.ids.size(), candidate_of_id.size()));
  }
  return out;
}

}  // namespace plumbline::internal
