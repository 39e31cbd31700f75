#include "calib/internal/board_discs.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "calib/internal/opencv_image.h"
#include "calib/median.h"

namespace plumbline::internal {
namespace {

// How far from a dot's centre the fit may look, in the dot's own radii: half way to the nearest
// other blob, and not much further than its blurred edge.
double Reach(const DotCandidates& candidates, int index) {
  const Ellipse& ellipse = candidates.dots[static_cast<std::size_t>(index)].ellipse;
  const double radius = ellipse.MeanRadiusPx();
  double reach = 1 + std::max(0.5, 6 / radius);
  for (std::size_t i = 0; i < candidates.dots.size(); ++i) {
    if (static_cast<int>(i) == index) continue;
    const Ellipse& other = candidates.dots[i].ellipse;
    // A blob inside this one is the hole of a ring.
    const double distance = ellipse.NormalisedRadius(other.centre);
    if (distance < 1) continue;
    const double gap = distance - 1 - other.MeanRadiusPx() / radius;
    reach = std::min(reach, 1 + std::max(0.15, gap / 2));
  }
  return reach;
}

// px^2 of image for one mm^2 of board around a point, from the nearest detected points.
std::optional<double> LocalMagnification(const BoardSpec& spec, const BoardDetection& detection,
                                         std::size_t index) {
  const Eigen::Vector3d here = spec.NominalPoint(detection.ids[index]);
  Eigen::Matrix2d board = Eigen::Matrix2d::Zero(), both = Eigen::Matrix2d::Zero();
  int count = 0;
  for (std::size_t k = 0; k < detection.ids.size(); ++k) {
    const Eigen::Vector2d step = (spec.NominalPoint(detection.ids[k]) - here).head<2>();
    if (k == index || step.norm() > 1.6 * spec.pitch_mm) continue;
    board += step * step.transpose();
    both += (detection.pixels[k] - detection.pixels[index]) * step.transpose();
    ++count;
  }
  if (count < 3 || board.determinant() < 1e-6 * board.squaredNorm()) return std::nullopt;
  return std::abs((both * board.inverse()).determinant());
}

}  // namespace

DotLattice FindDotLattice(const GrayImage& image, const BoardSpec& spec, double largest_ratio) {
  const cv::Mat grey = ToMat8(image);
  const auto wanted = static_cast<std::size_t>(spec.PointCount());
  DotLattice best;
  for (const bool dark : {true, false}) {
    DotLattice lattice;
    lattice.dark = dark;
    lattice.candidates = FindDotCandidates(grey, dark);
    for (const DotCandidate& dot : lattice.candidates.dots) {
      lattice.points.push_back({dot.ellipse.centre, dot.ellipse.AreaPx2()});
    }
    lattice.grid = OrderPoints(lattice.points, wanted, largest_ratio);
    if (dark || lattice.grid.points.size() > best.grid.points.size()) best = std::move(lattice);
    if (10 * best.grid.points.size() >= 6 * wanted) break;
  }
  return best;
}

std::pair<int, int> Extent(const PointGrid& grid) {
  if (grid.points.empty()) return {0, 0};
  int low_i = 1 << 20, high_i = -low_i, low_j = low_i, high_j = -low_i;
  for (const auto& [place, index] : grid.points) {
    low_i = std::min(low_i, place.first);
    high_i = std::max(high_i, place.first);
    low_j = std::min(low_j, place.second);
    high_j = std::max(high_j, place.second);
  }
  return {high_i - low_i + 1, high_j - low_j + 1};
}

bool ReachesImageEdge(const DotLattice& lattice, ImageSize size) {
  for (const auto& [place, index] : lattice.grid.points) {
    const Eigen::Vector2d p = lattice.points[static_cast<std::size_t>(index)].pixel;
    for (const auto& [di, dj] : {GridPlace{1, 0}, GridPlace{0, 1}}) {
      const auto next = lattice.grid.points.find({place.first + di, place.second + dj});
      if (next == lattice.grid.points.end()) continue;
      const Eigen::Vector2d q = lattice.points[static_cast<std::size_t>(next->second)].pixel;
      for (const Eigen::Vector2d& far :
           {Eigen::Vector2d(p - 1.5 * (q - p)), Eigen::Vector2d(q + 1.5 * (q - p))}) {
        if (far.x() < 0 || far.y() < 0 || far.x() > size.width - 1 || far.y() > size.height - 1) {
          return true;
        }
      }
    }
  }
  return false;
}

BoardDetection FitBoardDiscs(const BoardSpec& spec, const GrayImage& image,
                             const DotLattice& lattice, const std::map<int, int>& candidate_of_id) {
  BoardDetection out;
  std::vector<double> areas;
  for (const auto& [id, index] : candidate_of_id) {
    const DotCandidate& dot = lattice.candidates.dots[static_cast<std::size_t>(index)];
    const auto fit = FitDisc(image, dot.ellipse, Reach(lattice.candidates, index), dot.ring);
    if (!fit || (fit->contrast > 0) != lattice.dark) continue;
    out.ids.push_back(id);
    out.pixels.push_back(fit->ellipse.centre);
    out.sigma_px.push_back(std::sqrt(fit->cov_px2.trace() / 2));
    areas.push_back(fit->ellipse.AreaPx2());
  }
  std::vector<double> radii;
  for (std::size_t k = 0; k < out.ids.size(); ++k) {
    if (const auto magnification = LocalMagnification(spec, out, k)) {
      radii.push_back(std::sqrt(areas[k] / *magnification / std::numbers::pi));
    }
  }
  out.disc_radius_mm = radii.empty() ? 0 : Median(std::move(radii));
  return out;
}

}  // namespace plumbline::internal
