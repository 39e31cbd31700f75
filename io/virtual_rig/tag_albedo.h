#pragma once

#include <array>
#include <memory>
#include <string>
#include <string_view>

#include "io/virtual_rig/albedo.h"
#include "io/virtual_rig/material_surface.h"

namespace plumbline {

// AprilTags on the inner surface of a tyre, evenly around it: tag i at u = (i + 1/2) / count of a
// turn, v = +lateral_mm for even i and -lateral_mm for odd ones, upright as the cameras see it when
// the material's u goes to the right.
struct WheelTagOptions {
  std::string family = "tag36h11";  // as the apriltag library calls it
  int count = 0;                    // ids 0 to count - 1
  double size_mm = 24;              // side of the black border, from its outer edges
  double lateral_mm = 40;
  double black = 0.05, white = 0.9;  // albedo
  double edge_mm = 0.05;             // width of the edges' soft ramp

  // "36h11:12:24mm": family, count, size. Throws UsageError saying what a right one looks like.
  static WheelTagOptions Parse(std::string_view word);

  // Throws UsageError naming the broken constraint: tags that are too many for their family or
  // their place, or that reach beyond the surface.
  void Check(const MaterialDomain& domain) const;
};

// The corners of a tag's black border, as DetectedTag has them: bottom left, bottom right, top
// right, top left; material coordinates (mm). Throws std::out_of_range where there is no such tag.
std::array<Eigen::Vector2d, 4> WheelTagCorners(const MaterialDomain& domain,
                                               const WheelTagOptions& options, int id);

// The tags over what is `under` them, each with a white margin of one module. A formula of the
// material coordinates, as the speckle is. Throws UsageError as Check().
std::unique_ptr<const Albedo> MakeTaggedAlbedo(std::unique_ptr<const Albedo> under,
                                               const MaterialDomain& domain,
                                               const WheelTagOptions& options);

}  // namespace plumbline
