#pragma once

#include <cstdint>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// The mean spectrum of square tiles, each less its mean and under a Hann window, scaled so that
// white noise has its variance at every frequency.
class TileSpectrum {
 public:
  // `mask` may be empty.
  TileSpectrum(const GrayImage& image, const Image<std::uint8_t>& mask);

  bool empty() const { return tile_px_ == 0; }
  int tile_px() const { return tile_px_; }

  // The floor at the highest frequencies, in rows and columns both: what white noise gives,
  // rounding included, and what sharp edges leave there.
  double FloorGrey2() const;

  // Full width at half maximum of the autocorrelation, the mean over all directions, noise of this
  // variance taken off. NaN where it stays above half up to half a tile, or noise is all there is.
  double FeatureSizePx(double noise_grey2) const;

  // Standard deviation of the Gaussian by which sharp edges (whose spectrum falls with the cube of
  // the frequency) would have to be blurred to fall as the spectrum does, as far as it stands above
  // the noise. NaN where that is not far enough to tell.
  double BlurPx(double noise_grey2, double feature_px) const;

 private:
  std::vector<double> Radial() const;  // by whole numbers of periods a tile

  int tile_px_ = 0;
  std::vector<double> power_;   // tile_px^2, frequency 0 first
  std::vector<double> window_;  // its own power spectrum, likewise
};

}  // namespace plumbline::internal
