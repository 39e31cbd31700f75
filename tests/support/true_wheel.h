#pragma once

#include "fit/carcass_thickness.h"
#include "fit/wheel_axis.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline::testing {

// The scenario of a tyre, with so many frames and turning so far between them.
inline Scenario TurningBy(double step_rad, int frames, Scenario scenario) {
  scenario.frames = frames;
  const auto& tyre = std::get<TyreOptions>(scenario.surface);
  scenario.frames_per_second = tyre.speed_mm_s / tyre.free_rolling_radius_mm / step_rad;
  return scenario;
}

// The true thickness of the carcass, by place along the axis as it was found; step_mm apart on the
// meridian.
inline CarcassThickness TrueCarcass(const VirtualRig& rig, const WheelAxis& axis, double step_mm) {
  CarcassThickness carcass;
  const auto truth = rig.Truth(0);
  const Rigid3 wheel_from_ground =
      axis.RigFromWheel(0).Inverse() * truth->ground_from_rig().Inverse();
  for (double v = -110; v <= 110; v += step_mm) {
    const TruePoint point = truth->OfMaterial({0, v});
    carcass.y_mm.push_back((wheel_from_ground * (point.position_mm - point.displacement_mm)).y());
    carcass.thickness_mm.push_back(rig.tyre()->CarcassThickness(v));
  }
  return carcass;
}

}  // namespace plumbline::testing
