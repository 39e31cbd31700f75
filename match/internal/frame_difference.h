#pragma once

#include <cstdint>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// Grey levels that a pixel must lie strictly between to count as not clipped.
struct GreyLimits {
  int low = 0;
  int high = 255;
};

// The ends of the scale; or where many more pixels than on the neighbouring levels have the lowest
// or highest level that occurs, that level: a sensor may saturate below the file's largest value.
GreyLimits FindGreyLimits(const GrayImage& a, const GrayImage& b);

// What is left of the difference of two frames of a scene at rest, once all that is not noise is
// taken out.
struct FrameDifference {
  // b - a less the fit of its tile, scaled to undo the parameters fitted; NaN: does not count.
  Image<float> residual;
  std::int64_t counted = 0, black = 0, white = 0;  // pixels; clipped in either frame
  std::int64_t identical = 0;                      // counted ones that are the same in both
  int tiles = 0, changed_tiles = 0;                // looked at, and left out because of scatter
  double motion_px = 0;                            // what nine tenths of the tiles stay below
  double brightness_ratio = 1;                     // of b to a
  double likeness = 1;  // correlation of a and b; 1 where they agree when moved
};

// `mask` may be empty. Parallel over tiles, the same for any number of threads.
FrameDifference DifferenceOfStillFrames(const GrayImage& a, const GrayImage& b,
                                        const Image<std::uint8_t>& mask, int tile_px);

}  // namespace plumbline::internal
