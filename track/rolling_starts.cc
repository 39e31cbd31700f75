#include "track/rolling_starts.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace plumbline {
namespace {

// A place between the points of a grid: its corner and the parts of a step beyond that.
struct Cell {
  int row = 0, column = 0;
  double down = 0, along = 0;
};

// The cell of a pixel, or the nearest one to it.
Cell CellOf(const Eigen::Vector2d& px, const Eigen::Vector2i& first_px, int step_px,
            ImageSize grid) {
  const Eigen::Vector2d at = (px - first_px.cast<double>()) / step_px;
  Cell cell;
  cell.column = std::clamp(static_cast<int>(std::floor(at.x())), 0, grid.width - 2);
  cell.row = std::clamp(static_cast<int>(std::floor(at.y())), 0, grid.height - 2);
  cell.along = at.x() - cell.column;
  cell.down = at.y() - cell.row;
  return cell;
}

// Between the values at the four corners, linear along both axes; beyond them likewise.
template <typename Value>
Value Between(const Image<Value>& values, const Cell& at) {
  const int r = at.row, c = at.column;
  return (1 - at.down) * ((1 - at.along) * values(r, c) + at.along * values(r, c + 1)) +
         at.down * ((1 - at.along) * values(r + 1, c) + at.along * values(r + 1, c + 1));
}

Eigen::Matrix2d GradientBetween(const Image<Eigen::Vector2d>& values, const Cell& at, int step_px) {
  const int r = at.row, c = at.column;
  Eigen::Matrix2d gradient;
  gradient.col(0) = (1 - at.down) * (values(r, c + 1) - values(r, c)) +
                    at.down * (values(r + 1, c + 1) - values(r + 1, c));
  gradient.col(1) = (1 - at.along) * (values(r + 1, c) - values(r, c)) +
                    at.along * (values(r + 1, c + 1) - values(r, c + 1));
  return gradient / step_px;
}

}  // namespace

RightPlace RightPlaceOf(const WheelReference& wheel, const WheelReferenceView& view) {
  const Rigid3 right_from_wheel =
      wheel.rig.right_from_left * wheel.axis.RigFromWheel(view.angle_rad);
  return [&wheel, &view, right_from_wheel](const Eigen::Vector2d& px) -> Eigen::Vector2d {
    const ImageSize grid = view.point_mm.size();
    const Eigen::Vector2d nowhere =
        Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    if (grid.width < 2 || grid.height < 2) return nowhere;
    const Cell cell = CellOf(px, view.first_px, view.step_px, grid);
    // The surface goes on straight for the step or two between the last points and the edge.
    constexpr double kFarthest = 2.5;
    if (std::max({-cell.along, cell.along - 1, -cell.down, cell.down - 1}) > kFarthest) {
      return nowhere;
    }
    const Eigen::Vector3d point = Between(view.point_mm, cell);
    return wheel.rig.right.Project(right_from_wheel * point);
  };
}

StereoField StartsOf(const RollingWheel& rolling, std::size_t frame, const PlanarField& grid) {
  const Eigen::Vector2d nowhere =
      Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  std::array<Image<Eigen::Vector2d>, 2> moved = {Image<Eigen::Vector2d>(rolling.grid, nowhere),
                                                 Image<Eigen::Vector2d>(rolling.grid, nowhere)};
  for (const RollingPoint& p : rolling.frames[frame].points) {
    const Eigen::Vector2d here = (rolling.first_px + rolling.spacing_px * p.at).cast<double>();
    moved[0](p.at.y(), p.at.x()) = p.left_px - here;
    moved[1](p.at.y(), p.at.x()) = p.right_px - here;
  }
  StereoField starts;
  starts.left = starts.right = PlanarField(grid.size(), grid.first_px, grid.step_px);
  if (rolling.grid.width < 2 || rolling.grid.height < 2) return starts;
  for (int r = 0; r < grid.size().height; ++r) {
    for (int c = 0; c < grid.size().width; ++c) {
      const Cell cell =
          CellOf(grid.PixelOf(r, c), rolling.first_px, rolling.spacing_px, rolling.grid);
      if (std::min(cell.along, cell.down) < 0 || std::max(cell.along, cell.down) > 1) continue;
      for (std::size_t side = 0; side < 2; ++side) {
        PlanarField& field = side == 0 ? starts.left : starts.right;
        const Eigen::Vector2d displacement = Between(moved[side], cell);
        if (!displacement.allFinite()) continue;
        field.status(r, c) = Status::kOk;
        field.displacement_px(r, c) = displacement;
        field.gradient(r, c) = GradientBetween(moved[side], cell, rolling.spacing_px).cast<float>();
      }
    }
  }
  return starts;
}

}  // namespace plumbline
