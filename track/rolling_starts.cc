#include "track/rolling_starts.h"

#include <Eigen/Core>
#include <array>
#include <limits>

#include "track/internal/grid_cell.h"

namespace plumbline {

using internal::GridCell;

RightPlace RightPlaceOf(const WheelReference& wheel, const WheelReferenceView& view) {
  const Rigid3 right_from_wheel =
      wheel.rig.right_from_left * wheel.axis.RigFromWheel(view.angle_rad);
  return [&wheel, &view, right_from_wheel](const Eigen::Vector2d& px) -> Eigen::Vector2d {
    const ImageSize grid = view.point_mm.size();
    const Eigen::Vector2d nowhere =
        Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    if (grid.width < 2 || grid.height < 2) return nowhere;
    const GridCell cell = GridCell::Of(px, view.first_px, view.step_px, grid);
    // The surface goes on straight for the step or two between the last points and the edge.
    constexpr double kFarthest = 2.5;
    if (cell.Beyond() > kFarthest) return nowhere;
    const Eigen::Vector3d point = cell.Between(view.point_mm);
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
      const GridCell cell =
          GridCell::Of(grid.PixelOf(r, c), rolling.first_px, rolling.spacing_px, rolling.grid);
      if (cell.Beyond() > 0) continue;
      for (std::size_t side = 0; side < 2; ++side) {
        PlanarField& field = side == 0 ? starts.left : starts.right;
        const Eigen::Vector2d displacement = cell.Between(moved[side]);
        if (!displacement.allFinite()) continue;
        field.status(r, c) = Status::kOk;
        field.displacement_px(r, c) = displacement;
        field.gradient(r, c) = cell.GradientBetween(moved[side], rolling.spacing_px).cast<float>();
      }
    }
  }
  return starts;
}

}  // namespace plumbline
