#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <utility>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// Finds the points of a frame around a bit of material, and the weights by which they tell where it
// is. material: angle on the wheel (rad, any turn), place along the axis (mm), undeformed radius
// (mm).
class MaterialLookup {
 public:
  // point_mm: NaN where a point is missing. reach_mm 0: 1.7 times the median distance of
  // neighbours.
  MaterialLookup(const Image<Eigen::Vector3d>& material, const Image<Eigen::Vector3d>& point_mm,
                 double reach_mm);

  // Weights of sum 1 by place, in order, that carry every linear function of the material
  // coordinates over exactly. Empty where the points do not surround the material.
  std::vector<std::pair<std::size_t, double>> SharesAt(const Eigen::Vector3d& material) const;

 private:
  int Column(double angle_rad) const;
  int Row(double y_mm) const;

  const Image<Eigen::Vector3d>& material_;
  double reach_mm_ = 0;
  double low_y_mm_ = 0;
  double cell_rad_ = 0;
  int columns_ = 0, rows_ = 0;
  std::vector<std::vector<std::size_t>> cells_;
};

}  // namespace plumbline::internal
