#pragma once

#include <Eigen/Core>
#include <cmath>

#include "io/virtual_rig/material_surface.h"

namespace plumbline::testing {

// The strain that positions alone show: tangents by central differences of step h.
inline Eigen::Vector3d StrainByDifferences(const SurfaceInstant& reference,
                                           const SurfaceInstant& deformed, const Eigen::Vector2d& m,
                                           double h) {
  const auto tangents = [&](const SurfaceInstant& surface) {
    SurfacePoint point;
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d step = h * Eigen::Vector2d::Unit(k);
      point.d_position_d_material.col(k) =
          (surface.At(m + step).position_mm - surface.At(m - step).position_mm) / (2 * h);
    }
    return point;
  };
  return GreenLagrangeStrain(tangents(reference), tangents(deformed));
}

// Largest difference of exact tangents and velocity from fourth-order differences of positions.
inline double LargestDerivativeError(const MaterialSurface& surface, const Eigen::Vector2d& m,
                                     double time_s) {
  const auto derivative = [](const auto& at, double h) -> Eigen::Vector3d {
    return (at(-2 * h) - 8 * at(-h) + 8 * at(h) - at(2 * h)) / (12 * h);
  };
  const auto now = surface.At(time_s);
  const SurfacePoint exact = now->At(m);
  double largest = 0;
  for (int k = 0; k < 2; ++k) {
    const auto along = [&](double h) -> Eigen::Vector3d {
      return now->At(m + h * Eigen::Vector2d::Unit(k)).position_mm;
    };
    const Eigen::Vector3d error = derivative(along, 1e-2) - exact.d_position_d_material.col(k);
    largest = std::max(largest, error.norm());
  }
  const auto in_time = [&](double h) -> Eigen::Vector3d {
    return surface.At(time_s + h)->At(m).position_mm;
  };
  const double speed = std::max(1.0, now->Velocity(m).norm());
  return std::max(largest, (derivative(in_time, 1e-5) - now->Velocity(m)).norm() / speed);
}

}  // namespace plumbline::testing
