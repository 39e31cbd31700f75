#pragma once

#include <algorithm>

namespace plumbline {

// The photon-transfer line of a camera: the variance of a pixel's grey level is
// `offset_grey2 + slope_grey * grey` (read noise, and photons counted with a gain); rounding to
// whole levels not included. Grey levels are those of the image's own bits.
struct NoiseModel {
  double offset_grey2 = 0;
  double slope_grey = 0;

  double Variance(double grey) const { return std::max(0.0, offset_grey2 + slope_grey * grey); }
};

// Variance that rounding to whole grey levels adds.
inline constexpr double kRoundingVarianceGrey2 = 1.0 / 12.0;

}  // namespace plumbline
