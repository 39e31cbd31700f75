#include "fit/height_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Which points a place lies between and their shares; of infinite height where there are none.
struct Corners {
  std::array<std::size_t, 3> place{};
  Eigen::Vector3d share = Eigen::Vector3d::Zero();
  Eigen::Vector2d slope{0, 0};
  double height_mm = std::numeric_limits<double>::infinity();
};

// Puts one triangle of the surface over the places that lie under it.
void Cover(const SurfacePoints& surface, const std::array<std::size_t, 3>& place,
           const GroundGrid& grid, Image<Corners>& corners) {
  const Eigen::Vector3d& p = surface.point_mm.data()[place[0]];
  const Eigen::Vector3d u = surface.point_mm.data()[place[1]] - p;
  const Eigen::Vector3d v = surface.point_mm.data()[place[2]] - p;
  const double area = u.x() * v.y() - u.y() * v.x();
  if (!(std::abs(area) > 0)) return;  // seen from its edge
  const Eigen::Vector2d slope((v.y() * u.z() - u.y() * v.z()) / area,
                              (u.x() * v.z() - v.x() * u.z()) / area);
  const auto range = [&](int axis, int count) {
    const double low = p[axis] + std::min({0.0, u[axis], v[axis]}) - grid.first_mm[axis];
    const double high = p[axis] + std::max({0.0, u[axis], v[axis]}) - grid.first_mm[axis];
    const double first = std::clamp(std::ceil(low / grid.step_mm), 0.0, static_cast<double>(count));
    const double last = std::clamp(std::floor(high / grid.step_mm), -1.0, count - 1.0);
    return std::pair(static_cast<int>(first), static_cast<int>(last));
  };
  const auto [first_row, last_row] = range(1, grid.size.height);
  const auto [first_column, last_column] = range(0, grid.size.width);
  for (int r = first_row; r <= last_row; ++r) {
    for (int c = first_column; c <= last_column; ++c) {
      const Eigen::Vector2d d = grid.At(r, c) - p.head<2>();
      const double by_u = (d.x() * v.y() - d.y() * v.x()) / area;
      const double by_v = (u.x() * d.y() - u.y() * d.x()) / area;
      if (by_u < 0 || by_v < 0 || by_u + by_v > 1) continue;
      const double height = p.z() + by_u * u.z() + by_v * v.z();
      if (height < corners(r, c).height_mm) {
        corners(r, c) = {place, {1 - by_u - by_v, by_u, by_v}, slope, height};
      }
    }
  }
}

Image<Corners> CornersOf(const SurfacePoints& surface, const GroundGrid& grid) {
  Image<Corners> corners(grid.size);
  const int columns = surface.size().width;
  for (int r = 0; r + 1 < surface.size().height; ++r) {
    for (int c = 0; c + 1 < columns; ++c) {
      const auto first = static_cast<std::size_t>(r * columns + c);
      const std::size_t below = first + static_cast<std::size_t>(columns);
      const std::array<std::size_t, 4> cell = {first, first + 1, below, below + 1};
      const bool whole = std::all_of(cell.begin(), cell.end(), [&](std::size_t i) {
        return surface.point_mm.data()[i].allFinite();
      });
      if (!whole) continue;
      Cover(surface, {cell[0], cell[1], cell[3]}, grid, corners);
      Cover(surface, {cell[0], cell[2], cell[3]}, grid, corners);
    }
  }
  return corners;
}

}  // namespace

void GroundGrid::Check() const {
  if (!(step_mm > 0) || !first_mm.allFinite() || size.width < 0 || size.height < 0) {
    throw UsageError("A grid of the ground has a step above 0 mm and a finite beginning.");
  }
}

GroundGrid GridAround(const SurfacePoints& surface, double step_mm) {
  GroundGrid grid;
  grid.step_mm = step_mm;
  grid.Check();
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const Eigen::Vector3d& p : surface.point_mm.values()) {
    if (!p.allFinite()) continue;
    low = low.cwiseMin(p.head<2>());
    high = high.cwiseMax(p.head<2>());
  }
  if (!(low.x() <= high.x())) return grid;
  for (int axis = 0; axis < 2; ++axis) {
    grid.first_mm[axis] = step_mm * std::floor(low[axis] / step_mm);
  }
  const Eigen::Vector2d extent = (high - grid.first_mm) / step_mm;
  grid.size = {static_cast<int>(std::ceil(extent.x())) + 1,
               static_cast<int>(std::ceil(extent.y())) + 1};
  return grid;
}

HeightMap HeightsOf(const SurfacePoints& surface, const GroundGrid& grid,
                    const NeighbourCorrelation& neighbours) {
  surface.Check();
  grid.Check();
  const Image<Corners> corners = CornersOf(surface, grid);
  const float none = std::numeric_limits<float>::quiet_NaN();
  HeightMap map;
  map.grid = grid;
  map.height_mm = Image<double>(grid.size, kNaN);
  map.sigma_random_mm = Image<float>(grid.size, none);
  map.along_modes_mm.assign(surface.along_modes_mm.size(), Image<float>(grid.size, none));
  ForEachIndex(corners.pixel_count(), [&](std::size_t i) {
    const Corners& at = corners.data()[i];
    if (!std::isfinite(at.height_mm)) return;
    std::array<PointChange, 3> changes;  // in order of place
    for (std::size_t k = 0; k < 3; ++k) {
      changes[k] = {at.place[k], at.share[static_cast<Eigen::Index>(k)] *
                                     Eigen::RowVector3d(-at.slope.x(), -at.slope.y(), 1)};
    }
    const MeasuredScalar height = MeasuredSum(changes, at.height_mm, surface, neighbours);
    map.height_mm.data()[i] = height.value;
    map.sigma_random_mm.data()[i] = static_cast<float>(height.sigma_random);
    for (std::size_t k = 0; k < map.along_modes_mm.size(); ++k) {
      map.along_modes_mm[k].data()[i] =
          static_cast<float>(height.along_modes[static_cast<Eigen::Index>(k)]);
    }
  });
  return map;
}

HeightDifference CompareHeights(const HeightMap& now, const HeightMap& before, bool same_rig) {
  if (now.grid.size != before.grid.size || now.grid.first_mm != before.grid.first_mm ||
      now.grid.step_mm != before.grid.step_mm) {
    throw std::invalid_argument("CompareHeights: heights on different grids");
  }
  if (same_rig && now.along_modes_mm.size() != before.along_modes_mm.size()) {
    throw std::invalid_argument("CompareHeights: one rig with different calibration modes");
  }
  const float none = std::numeric_limits<float>::quiet_NaN();
  HeightDifference difference;
  difference.value_mm = Image<double>(now.grid.size, kNaN);
  difference.sigma_random_mm = Image<float>(now.grid.size, none);
  difference.sigma_calibration_mm = Image<float>(now.grid.size, none);
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < difference.value_mm.pixel_count(); ++i) {
    const double value = now.height_mm.data()[i] - before.height_mm.data()[i];
    if (!std::isfinite(value)) continue;
    difference.value_mm.data()[i] = value;
    difference.sigma_random_mm.data()[i] =
        std::hypot(now.sigma_random_mm.data()[i], before.sigma_random_mm.data()[i]);
    sum += value;
    squares += value * value;
    ++difference.count;
    if (now.along_modes_mm.empty() || before.along_modes_mm.empty()) continue;
    float variance = 0;
    const auto add = [&](float change) { variance += change * change; };
    for (std::size_t k = 0; k < now.along_modes_mm.size(); ++k) {
      add(now.along_modes_mm[k].data()[i] - (same_rig ? before.along_modes_mm[k].data()[i] : 0));
    }
    for (std::size_t k = 0; !same_rig && k < before.along_modes_mm.size(); ++k) {
      add(before.along_modes_mm[k].data()[i]);
    }
    difference.sigma_calibration_mm.data()[i] = std::sqrt(variance);
  }
  difference.mean_mm = sum / difference.count;
  difference.rms_mm = std::sqrt(squares / difference.count);
  return difference;
}

}  // namespace plumbline
