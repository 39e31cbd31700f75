#pragma once

#include <cstdint>

#include "calib/image.h"

namespace plumbline {

// How light becomes grey levels.
struct SensorOptions {
  int bits = 8;  // 8 to 16; grey levels 0 to 2^bits - 1
  // Photon transfer at 8 bits' scale (DESIGN: sigma_n^2(I) = b + a I): `gain_grey` grey levels an
  // electron, read noise in grey levels. Both are given for 8 bits and scaled by 2^(bits - 8).
  double gain_grey = 0.02;
  double read_noise_grey = 0.6;
  double black_level_grey = 4;  // that darkness reads, at 8 bits' scale
  bool noise = true;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// One exposure of a mean image (grey levels at 8 bits' scale, above black, unclipped): Poisson
// electrons, normal read noise, black level, rounding, saturation.
//
// stream: what tells this exposure from all others of the seed (camera and frame). Every row draws
// from its own generator, so that the result does not depend on the number of threads.
GrayImage Expose(const Image<float>& mean, const SensorOptions& sensor, std::uint64_t seed,
                 std::uint64_t stream);

}  // namespace plumbline
