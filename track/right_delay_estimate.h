#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <string>

#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline {

struct RightDelayEstimate {
  bool found = false;
  std::string problem;  // why not, in a sentence
  double value_s = std::numeric_limits<double>::quiet_NaN();
  double sigma_s = std::numeric_limits<double>::quiet_NaN();
  int frames = 0;  // used
};

// By how much the right camera exposes later, out of the survey's matches: what moves along the
// baseline alone stays on its epipolar line, but the tyre that rises before and behind the contact
// leaves it, up or down with the place in the image and in proportion to the wheel's speed.
//
// Per frame, by least squares with Cauchy weights over the points, with the epipolar distance e and
// the flow of the right pixel a radian (RightFlow), at the left pixel l:
//   e(l, right) - e(l, view's right) = delay speed d e / d turn
//                                      + a motion of the right camera since then (5 unknown)
// What lenses and calibration get wrong at a pixel is in both and cancels. A delay in the recording
// of the lifted wheel, which is round, is such a motion; so it is not told, and does not matter.
//
// steady: frames in which the tyre keeps its shape under the rig, as on flat ground; over an
// obstacle the flow is another one. subset_px: of the survey.
// Sigma: noise, with what the points scatter and share; or what views contradict each other, where
// that is more (matches with one view share its errors); what the calibration's modes do; and 3 %
// for the flow.
// Accuracy: tests/track/right_delay_test.cc; docs/rolling_tyre.md.
[[nodiscard]] RightDelayEstimate EstimateRightDelay(const WheelReference& reference,
                                                    const RollingWheel& rolling,
                                                    std::span<const std::uint8_t> steady,
                                                    int subset_px);

}  // namespace plumbline
