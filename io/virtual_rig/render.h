#pragma once

#include <Eigen/Core>
#include <functional>

#include "calib/camera.h"
#include "calib/rigid3.h"
#include "io/virtual_rig/albedo.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// How finely an image is made.
struct RenderOptions {
  int samples_per_px = 4;  // in each direction: 16 samples a pixel
  // Standard deviation of the lens's point-spread function (normal), besides the pixel's own area.
  double psf_sigma_px = 0.45;
  double full_scale_grey = 190;     // of a white surface in light 1, above black, at 8 bits' scale
  double background_albedo = 0.02;  // where no surface is seen

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// One exposure: the surface and the place of the camera when the shutter opens and closes. Between
// them the material moves linearly under each pixel. closing == opening: no motion blur.
struct Exposure {
  const SurfaceInstant* opening = nullptr;
  const SurfaceInstant* closing = nullptr;
  Rigid3 camera_from_world_opening;
  Rigid3 camera_from_world_closing;
};

// Light on a surface point in the world frame, with its unit normal, relative to full_scale_grey.
using Light = std::function<double(const Eigen::Vector3d& point_mm, const Eigen::Vector3d& normal,
                                   const Eigen::Vector2d& pixel)>;

// The noise-free image of a surface, in grey levels at 8 bits' scale above black, not clipped.
//
// Every pixel is the mean over its area and over the point-spread function of albedo times light,
// by samples_per_px^2 samples a pixel at exactly known material points (internal/material_map.h);
// with motion blur each is the mean of two moments for every pixel of motion. Where an occluding
// edge passes a pixel during the exposure, what was seen at its opening is kept. Converges as
// samples grow. Uses all threads; the same for any number of them.
Image<float> Render(const Camera& camera, const Exposure& exposure, const Albedo& albedo,
                    const Light& light, const RenderOptions& options = {});

}  // namespace plumbline
