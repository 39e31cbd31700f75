#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "fit/surface_points.h"

namespace plumbline {

// A grid of places in the ground plane that several frames or runs are told on: column and row
// count along x and y.
struct GroundGrid {
  Eigen::Vector2d first_mm{0, 0};
  double step_mm = 2;
  ImageSize size;

  Eigen::Vector2d At(int row, int column) const {
    return first_mm + step_mm * Eigen::Vector2d(column, row);
  }
  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Heights of a surface over the ground plane; NaN where nothing is known.
struct HeightMap {
  GroundGrid grid;
  Image<double> height_mm;
  Image<float> sigma_random_mm;  // of each by itself, errors in common included
  std::vector<Image<float>> along_modes_mm;
};

// Heights of the points of a surface (ground frame, z up) at the places of a grid, linear over the
// two triangles of each cell of the surface's own grid; where it lies over itself, the lower one.
// Nothing is filled in: a place beside all cells with four points has no height. An error moves it
// by the weighted mean of dz - slope . (dx, dy) over the corners.
// Throws UsageError from the grid, std::invalid_argument where sizes differ.
[[nodiscard]] HeightMap HeightsOf(const SurfacePoints& surface, const GroundGrid& grid,
                                  const NeighbourCorrelation& neighbours);

// The least grid that holds all points of a surface; empty without points. It begins at a whole
// number of steps from the frame's origin, so that grids of several runs are parts of one.
[[nodiscard]] GroundGrid GridAround(const SurfacePoints& surface, double step_mm);

// Heights of one run above another at common places.
struct HeightDifference {
  Image<double> value_mm;  // NaN where either is
  Image<float> sigma_random_mm, sigma_calibration_mm;
  double rms_mm = 0, mean_mm = 0;
  int count = 0;  // places in both
};

// same_rig: both were measured with one calibration, whose modes then move both at once; else the
// errors of both add up. Random errors are independent of each other.
// Throws std::invalid_argument where the grids differ, or the modes of one rig do.
[[nodiscard]] HeightDifference CompareHeights(const HeightMap& now, const HeightMap& before,
                                              bool same_rig);

}  // namespace plumbline
