#pragma once

#include "calib/image.h"

namespace plumbline::internal {

// The coefficients of the cubic B-spline through each row's samples: interpolation along x only,
// which is all that a rectified pair needs. Mirrored at the borders.
// Source: Unser, "Splines: a perfect fit for signal and image processing", 1999, section 3.
Image<float> RowSplineCoefficients(const Image<float>& image);

// Weights of the coefficients i - 1 .. i + 2 for the value at i + t, 0 <= t < 1.
inline void CubicWeights(float t, float w[4]) {
  const float t2 = t * t;
  const float t3 = t2 * t;
  w[0] = (1 - 3 * t + 3 * t2 - t3) / 6;
  w[1] = (4 - 6 * t2 + 3 * t3) / 6;
  w[2] = (1 + 3 * t + 3 * t2 - 3 * t3) / 6;
  w[3] = t3 / 6;
}

}  // namespace plumbline::internal
