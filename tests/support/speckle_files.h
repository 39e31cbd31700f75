#pragma once

#include <filesystem>
#include <functional>

#include "io/image_writer.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline::testing {

inline constexpr ImageSize kSpecimenSize{220, 180};

// A specimen as one camera sees it in frame k: moved by (1.3, -0.6) k px, and stretched by 0.2 % k
// along x about the image's centre.
inline Eigen::Vector2d SpecimenDisplacement(int frame, const Eigen::Vector2d& x) {
  return {1.3 * frame + 0.002 * frame * (x.x() - 110), -0.6 * frame};
}

inline GrayImage SpecimenImage(int frame, double noise = 1, ImageSize size = kSpecimenSize) {
  return RenderSpeckle(
      size,
      [&](const Eigen::Vector2d& p) {
        return Eigen::Vector2d(110 + (p.x() - 110 - 1.3 * frame) / (1 + 0.002 * frame),
                               p.y() + 0.6 * frame);
      },
      noise, static_cast<std::uint32_t>(7 + frame));
}

// image_0.png (the reference) to image_<last>.png in a folder, which is made.
inline void WriteSpecimen(const std::filesystem::path& folder, int last) {
  std::filesystem::create_directories(folder);
  for (int k = 0; k <= last; ++k) {
    WritePng(folder / ("image_" + std::to_string(k) + ".png"), SpecimenImage(k));
  }
}

}  // namespace plumbline::testing
