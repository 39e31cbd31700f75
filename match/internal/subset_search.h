#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// A square piece of the reference, ready for zero-normalised cross-correlation.
struct SubsetTemplate {
  Eigen::Vector2i centre_px{0, 0};
  int radius_px = 0;
  std::vector<float> value;  // grey less mean over the pixels in use, 0 where not in use; row-major
  std::vector<float> weight;  // 1 in use, 0 not; empty when all are
  double count = 0;           // pixels in use
  double norm = 0;            // square root of the sum of value^2

  int side_px() const { return 2 * radius_px + 1; }
};

// None where the template leaves the image, more than half of it is masked, its standard
// deviation is below min_contrast, or its texture has one direction only.
std::optional<SubsetTemplate> CutTemplate(const Image<float>& reference,
                                          const Image<std::uint8_t>& mask,
                                          const Eigen::Vector2i& centre_px, int radius_px,
                                          double min_contrast);

// Windows with less than this share of the template's contrast are no match, whatever their ZNCC.
inline constexpr double kLeastContrastShare = 0.2;

struct SubsetMatch {
  Eigen::Vector2d displacement_px{0, 0};
  double zncc = 0;
};

// The maximum of the ZNCC within reach_px of a predicted affine motion (gradient about the
// template's centre), to a fraction of a pixel by a parabola along either axis. Where the maximum
// lies on the border of the window, the window moves on, twice at most. None where no maximum is
// reached or the subset leaves the image.
std::optional<SubsetMatch> SearchAround(const SubsetTemplate& subset, const Image<float>& deformed,
                                        const Eigen::Vector2d& displacement_px,
                                        const Eigen::Matrix2d& gradient, int reach_px);

// Offset of the maximum of a parabola through -1, 0, 1; within half a pixel. 0 where there is none.
double ParabolaPeak(double left, double centre, double right);

}  // namespace plumbline::internal
