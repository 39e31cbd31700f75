#pragma once

#include "match/internal/refine_disparity.h"

namespace plumbline::internal {

// The factors of the model of sigma, fitted once on pairs with known truth, the same for all
// images: docs/disparity.md says how, and what they give on pairs that were held out.
//
//   refined:  sigma^2 = noise * kappa * variance_px2 + misfit * m / (m + saturation) + relief * r^2
//   stayed:   sigma^2 = stayed^2 + stayed_relief * r^2
//
// kappa is CorrelatedNoiseFactor(), m is VerticalMisfit(), r is relief_px.
struct SigmaModel {
  double noise = 0.48;
  double misfit_px2 = 0.0182;
  double misfit_saturation_px2 = 0.01;
  double relief = 1.06;
  double stayed_px2 = 0.04;
  double stayed_relief = 2.5;
};

// One standard deviation of refined.value_px; NaN where there is none.
Image<float> DisparitySigma(const RefinedDisparity& refined, const GrayImage& left, int radius_px);

// Factor by which correlated residuals raise the variance over that of white ones: the sum over
// lags of the residuals' autocorrelation times the gradients' (the sandwich estimator, averaged
// over the image).
double CorrelatedNoiseFactor(const RefinedDisparity& refined, const GrayImage& left, int radius_px);

// Mean square (px^2) of what the two images are apart across the epipolar lines, from how the
// squared residuals grow with the squared vertical gradient. The same errors of lens, rectification
// and reflection act along the lines, where nothing else shows them.
double VerticalMisfit(const RefinedDisparity& refined, const GrayImage& left);

}  // namespace plumbline::internal
