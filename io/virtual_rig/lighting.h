#pragma once

#include <Eigen/Core>
#include <vector>

#include "calib/camera.h"
#include "calib/rigid3.h"
#include "io/virtual_rig/render.h"

namespace plumbline {

// The light-emitting diodes beside the cameras, the lens's vignetting, and how steady both are.
struct LightingOptions {
  std::vector<Eigen::Vector3d> leds_in_rig_mm = {{-45, 0, 0}, {85, 0, 0}};
  double ambient = 0.4;  // share that comes evenly from everywhere
  // At which light is 1, for a surface that faces the diodes.
  double reference_distance_mm = 160;
  double vignetting = 0.25;  // loss at the corner of the image, growing with the radius squared
  double flicker = 0.01;     // standard deviation of the brightness between frames, relative

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The light of one frame for Render(): inverse-square diodes with a Lambertian surface, ambient
// light, vignetting, times brightness. Surfaces are lit on both sides.
Light MakeLight(const LightingOptions& options, const Camera& camera, const Rigid3& ground_from_rig,
                double brightness);

}  // namespace plumbline
