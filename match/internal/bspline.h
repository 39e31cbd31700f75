#pragma once

#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// B-splines of degree 3 and 5 on a regular grid of samples.
// Source: Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing
// Magazine 16(6), 1999, sections on digital filters (poles, mirrored borders).

// Coefficients that a value between samples is made of.
constexpr int SplineTaps(int degree) { return degree + 1; }

// Index of the sample that a border mirrored about the outermost samples shows at place i.
int Mirrored(int i, int size);

// Weights of the coefficients floor(x) - (degree - 1) / 2 ... for the value at x, fraction t in
// [0, 1]; and those of the derivative by x.
void SplineWeights(int degree, double t, double* weights);
void SplineSlopeWeights(int degree, double t, double* weights);

// The cubic ones in float, for loops over many places.
inline void CubicWeights(float t, float weights[4]) {
  const float t2 = t * t;
  const float t3 = t2 * t;
  weights[0] = (1 - 3 * t + 3 * t2 - t3) / 6;
  weights[1] = (4 - 6 * t2 + 3 * t3) / 6;
  weights[2] = (1 + 3 * t + 3 * t2 - 3 * t3) / 6;
  weights[3] = t3 / 6;
}

// The weights by powers of s = t - 1/2: that of tap k is sum_i even[i][k] s^(2 i) + s sum_i
// odd[i][k] s^(2 i). The last half of the taps mirrors the first: the same even ones, minus the odd
// ones. Zeros behind the last tap.
struct SplineTapPolynomials {
  alignas(32) float even[3][8];
  alignas(32) float odd[3][8];
};
SplineTapPolynomials TapPolynomials(int degree);

// Samples to coefficients, in place, mirrored about the border samples. Uses all threads, the same
// for any number of them. An axis of one sample is left as it is.
void SamplesToCoefficients(int degree, Image<float>& image);

// The same along x only, each row for itself: all that a rectified pair needs.
void RowSamplesToCoefficients(int degree, Image<float>& image);

// The samples of the spline that has these coefficients, filtered along x by `along_x` and along y
// by `along_y` (odd numbers of taps, correlation, mirrored borders).
Image<float> FilterSeparably(const Image<float>& image, const std::vector<float>& along_x,
                             const std::vector<float>& along_y);

// Normalised taps of a Gaussian, cut at 4 sigma.
std::vector<float> GaussianTaps(double sigma_px);

// 11 taps of the low-pass with two pairs of zeros at half the sampling rate that is flat to the
// seventh order at zero: gain (1 - x)^2 (1 + 2 x + 3 x^2 + 4 x^3) with x = sin^2(omega / 2).
// Source: Herrmann, "On the approximation problem in nonrecursive digital filter design", IEEE
// Trans. Circuit Theory 18(3), 1971.
std::vector<float> LowPassTaps();

// Energy sum_k phi(t - k)^2 of the weights that the samples k have in a value at fraction t, for
// samples that are filtered by `taps` first: what interpolation leaves of white noise's variance,
// along one axis.
double NoiseEnergy(int degree, const std::vector<float>& taps, double t);

}  // namespace plumbline::internal
