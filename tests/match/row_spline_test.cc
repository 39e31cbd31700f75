#include "match/internal/row_spline.h"

#include <gtest/gtest.h>

#include <cmath>

namespace plumbline::internal {
namespace {

float At(const Image<float>& coefficients, int row, float x) {
  const int column = static_cast<int>(x);
  float w[4];
  CubicWeights(x - static_cast<float>(column), w);
  const float* c = coefficients.row(row) + column - 1;
  return w[0] * c[0] + w[1] * c[1] + w[2] * c[2] + w[3] * c[3];
}

TEST(RowSpline, PassesThroughTheSamplesUpToTheBorders) {
  Image<float> image({37, 2});
  for (int x = 0; x < 37; ++x) {
    image(0, x) = static_cast<float>((x * 7919) % 251);
    image(1, x) = static_cast<float>((x * 104729) % 239);
  }
  const Image<float> c = RowSplineCoefficients(image);
  for (int row = 0; row < 2; ++row) {
    for (int x = 1; x < 35; ++x)
      EXPECT_NEAR(At(c, row, static_cast<float>(x)), image(row, x), 1e-3);
  }
}

TEST(RowSpline, FollowsAWaveBetweenTheSamples) {
  Image<float> image({80, 1});
  for (int x = 0; x < 80; ++x) image(0, x) = 100 * std::sin(0.7F * static_cast<float>(x));
  const Image<float> c = RowSplineCoefficients(image);
  for (float x = 15; x < 65; x += 0.13F) {
    EXPECT_NEAR(At(c, 0, x), 100 * std::sin(0.7F * x), 0.1F) << x;
  }
}

}  // namespace
}  // namespace plumbline::internal
