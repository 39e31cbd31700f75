#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/status.h"
#include "match/noise_model.h"

namespace plumbline {

struct SpeckleCheckOptions {
  int subset_px = 33;                              // side of the square subset, odd
  int step_px = 0;                                 // between POIs; 0: half a subset
  double wanted_sigma_px = 0.01;                   // of either component of the displacement
  int largest_subset_px = 151;                     // that is tried for it, odd
  std::optional<NoiseModel> noise = std::nullopt;  // nothing: estimated from the image

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What a subset about one pixel can tell.
struct SpecklePoi {
  Eigen::Vector2i centre_px{0, 0};
  Status status = Status::kLowTexture;  // kOk, kLowTexture, or kMasked: too few pixels are left
  Eigen::Matrix2d cov_px2;              // of its displacement (x, y) from noise; NaN unless kOk
  double sigma_px = 0;                  // in the worse direction; NaN unless kOk
  int smallest_subset_px = 0;           // that reaches the wanted sigma here; 0: none
};

// A part of the image where displacements come out worse than elsewhere.
struct WeakRegion {
  int x = 0, y = 0, width = 0, height = 0;  // that its POIs' subsets cover, px
  std::string where;                        // "the upper left", "the middle"
  std::int64_t pois = 0;
  double sigma_px = 0;  // the median; NaN where most have no texture at all
};

// Whether an image is fit for correlation, before anything is correlated.
struct SpeckleCheck {
  NoiseModel noise;
  bool noise_estimated = false;  // from this image
  std::int64_t pixels = 0;       // looked at
  double mean_grey = 0;
  double contrast_grey = 0;       // standard deviation of the grey levels, noise taken off
  double black_share = 0;         // of the pixels, clipped at the lowest level
  double white_share = 0;         // saturated
  double mean_gradient_grey = 0;  // a pixel; mean length of the gradient, noise taken off
  double feature_px = 0;  // full width at half maximum of the autocorrelation; NaN: cannot be told
  // The Gaussian by which perfectly sharp edges would have to be blurred to look as these do. A
  // good camera in focus has 0.3 to 0.6 px; NaN: noise or too little texture hides it.
  double blur_px = 0;

  std::vector<SpecklePoi> pois;
  std::int64_t measurable_pois = 0;  // kOk
  double median_sigma_px = 0;        // of those; NaN without any
  double sigma95_px = 0;             // that 95 % of them stay below
  // Smallest odd side with which 95 % of the POIs that are not masked reach the wanted sigma; 0:
  // not even the largest tried.
  int subset_for_wanted_px = 0;
  std::vector<WeakRegion> weak;     // the largest first
  std::vector<std::string> advice;  // one sentence each; empty: nothing to complain about
};

// Predicts from one image how well its speckle can be correlated.
//
// sigma: displacement of a subset against an image with the same noise, both images counted,
//   cov = H^-1 (sum (2 v g g' - n v^2 I)) H^-1,   H = sum (g g' - n v I),
// with g the gradients as measured (five-point central difference, noise gain n = 65/72), v(I) the
// variance of a pixel's noise and of its rounding. The gradients' own noise is so taken off the
// information, and left in the scatter where it meets the noise of the other image: for equal v in
// one dimension it is (2 v / G) (1 + n v N / 2 G) with G the true gradient energy of the N pixels.
// It is the bound for shape functions of order 0 and 1, whose other terms hardly touch the centre's
// displacement; order 2 costs a factor of about sqrt(7/2) on top (square subset, even texture).
// Clipped pixels have no gradient to give, and count as they are.
//
// Mean intensity gradient: Pan, Lu and Xie, Optics and Lasers in Engineering 48 (2010).
// Units: px, grey levels of the image's own bits.
// `mask`: 0 is left out; empty: all counts.
// Throws UsageError from the options; InputError when the image is smaller than the subset, the
// mask has another size or leaves nothing, or all pixels have one level. Accuracy:
// tests/match/speckle_check_test.cc.
SpeckleCheck CheckSpeckle(const GrayImage& image, const SpeckleCheckOptions& options = {},
                          const Image<std::uint8_t>& mask = {});

// Variance of white noise, rounding not counted, from the image itself: the smaller of two upper
// bounds, the highest frequencies and the flattest tenth of all 5x5 windows.
double EstimateNoiseVariance(const GrayImage& image, const Image<std::uint8_t>& mask = {});

}  // namespace plumbline
