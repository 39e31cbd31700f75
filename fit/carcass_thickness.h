#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/image.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// How thick a tyre's carcass is, tread included, by the place along the wheel's axis at which it
// lies undeformed: one value for all, or a map with straight lines between its entries.
struct CarcassThickness {
  std::vector<double> y_mm;          // ascending, wheel frame; empty where thickness_mm has one
  std::vector<double> thickness_mm;  // measured along the normal of the surface

  // NaN beyond the ends of a map: nothing is known there.
  double At(double y_mm) const;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The thickness over each point of a grid, from where the point lies on the undeformed wheel (rig
// frame). NaN where there is no such place. Throws UsageError from CarcassThickness::Check.
[[nodiscard]] Image<double> ThicknessOver(const CarcassThickness& carcass,
                                          const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                          const WheelAxis& axis);

}  // namespace plumbline
