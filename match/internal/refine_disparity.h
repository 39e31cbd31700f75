#pragma once

#include <cstdint>

#include "calib/image.h"

namespace plumbline::internal {

enum class RefineOutcome : std::uint8_t {
  kNone,        // there was no disparity to start from
  kRefined,     // value and everything else are of the refined disparity
  kStayed,      // the refinement left its basin or did not converge: value is the starting one
  kTextureless  // fewer than kFewestSamples samples, or no gradient at all
};

// What the refinement found out about each pixel, all NaN where it has nothing to say.
struct RefinedDisparity {
  Image<float> value_px;
  Image<float> variance_px2;   // of value_px, from normal matrix and residual, taken as white
  Image<float> data_share;     // how much of value_px the grey values decide, not the start: 0..1
  Image<float> noise_grey;     // standard deviation of the residuals left - right
  Image<float> correlation;    // of the two windows, -1..1
  Image<float> residual_grey;  // residual of the centre pixel
  Image<float> gradient_noise_share;  // of the gradients' energy in the window
  Image<float> relief_px;             // rms departure of value_px in the window from a plane
  Image<float> support;               // share of the window that is on the same surface, 0..1
  Image<RefineOutcome> outcome;
};

// One-dimensional inverse-compositional Gauss-Newton (Baker and Matthews, "Lucas-Kanade 20 years
// on", IJCV 2004, section 3.2) of each pixel's disparity and its two slopes, with gain and offset
// of the grey levels as unknowns (the ZNSSD criterion), on a window of (2 radius + 1)^2 pixels.
// `start_px` holds NaN where there is no disparity; samples of the window whose start is further
// than 1.5 px from the plane of the centre's surface are left out. The start is a prior with
// standard deviation kStartSigmaPx, so that windows without texture keep it.
RefinedDisparity RefineDisparity(const GrayImage& left, const GrayImage& right,
                                 const Image<float>& start_px, int radius_px);

}  // namespace plumbline::internal
