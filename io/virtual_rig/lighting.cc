#include "io/virtual_rig/lighting.h"

#include <cmath>

#include "calib/error.h"

namespace plumbline {

void LightingOptions::Check() const {
  if (!(ambient >= 0 && ambient <= 1)) throw UsageError("The ambient share must lie in 0 to 1.");
  if (leds_in_rig_mm.empty() && ambient < 1) {
    throw UsageError("Without a diode all light is ambient: set the ambient share to 1.");
  }
  if (!(reference_distance_mm > 0)) throw UsageError("The reference distance must be positive.");
  if (!(vignetting >= 0 && vignetting < 1)) {
    throw UsageError("The vignetting must lie in 0 to 1.");
  }
  if (!(flicker >= 0 && flicker < 0.3)) throw UsageError("The flicker must lie in 0 to 0.3.");
}

Light MakeLight(const LightingOptions& options, const Camera& camera, const Rigid3& ground_from_rig,
                double brightness) {
  options.Check();
  std::vector<Eigen::Vector3d> leds;
  for (const Eigen::Vector3d& led : options.leds_in_rig_mm) leds.push_back(ground_from_rig * led);
  const Eigen::Vector2d middle((camera.size().width - 1) / 2.0, (camera.size().height - 1) / 2.0);
  return [=](const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
             const Eigen::Vector2d& pixel) {
    double direct = 0;
    for (const Eigen::Vector3d& led : leds) {
      const Eigen::Vector3d way = led - point;
      const double distance = way.norm(), near = options.reference_distance_mm / distance;
      direct += near * near * std::abs(normal.dot(way)) / distance;
    }
    if (!leds.empty()) direct /= static_cast<double>(leds.size());
    const double radius2 = (pixel - middle).squaredNorm() / middle.squaredNorm();
    return brightness * (1 - options.vignetting * radius2) *
           (options.ambient + (1 - options.ambient) * direct);
  };
}

}  // namespace plumbline
