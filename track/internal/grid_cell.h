#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "calib/image.h"

namespace plumbline::internal {

// A place between the points of a grid of pixels: its corner and the parts of a step beyond that.
struct GridCell {
  int row = 0, column = 0;
  double down = 0, along = 0;

  // The cell of a pixel, or the nearest one to it; of a grid of 2 x 2 points or more.
  static GridCell Of(const Eigen::Vector2d& px, const Eigen::Vector2i& first_px, int step_px,
                     ImageSize grid) {
    const Eigen::Vector2d at = (px - first_px.cast<double>()) / step_px;
    GridCell cell;
    cell.column = std::clamp(static_cast<int>(std::floor(at.x())), 0, grid.width - 2);
    cell.row = std::clamp(static_cast<int>(std::floor(at.y())), 0, grid.height - 2);
    cell.along = at.x() - cell.column;
    cell.down = at.y() - cell.row;
    return cell;
  }

  // How many steps beyond the cell the pixel is; 0 or less inside.
  double Beyond() const { return std::max({-along, along - 1, -down, down - 1}); }

  // Between the values at the four corners, linear along both axes; beyond them likewise.
  template <typename Value>
  Value Between(const Image<Value>& values) const {
    return (1 - down) * ((1 - along) * values(row, column) + along * values(row, column + 1)) +
           down * ((1 - along) * values(row + 1, column) + along * values(row + 1, column + 1));
  }

  // d Between() / d pixel.
  Eigen::Matrix2d GradientBetween(const Image<Eigen::Vector2d>& values, int step_px) const {
    Eigen::Matrix2d gradient;
    gradient.col(0) = (1 - down) * (values(row, column + 1) - values(row, column)) +
                      down * (values(row + 1, column + 1) - values(row + 1, column));
    gradient.col(1) = (1 - along) * (values(row + 1, column) - values(row, column)) +
                      along * (values(row + 1, column + 1) - values(row, column + 1));
    return gradient / step_px;
  }
};

}  // namespace plumbline::internal
