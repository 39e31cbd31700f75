#include "track/internal/finite_differences.h"

#include <gtest/gtest.h>

#include <array>
#include <span>
#include <vector>

namespace plumbline {
namespace {

constexpr std::array kTimes = {0.02, 0.04, 0.08};

double Parabola(double t) { return 3 * t * t - 2 * t + 5; }

TEST(SlopeWeights, FollowAParabolaBetweenTimesThatAreNotAlikeApart) {
  for (std::size_t at = 0; at < kTimes.size(); ++at) {
    const std::vector<double> weights = internal::SlopeWeights(kTimes, at);
    double slope = 0;
    for (std::size_t k = 0; k < kTimes.size(); ++k) slope += weights[k] * Parabola(kTimes[k]);
    EXPECT_NEAR(slope, 6 * kTimes[at] - 2, 1e-12);
  }
}

TEST(SlopeWeights, OfTwoTimesAreThoseOfALine) {
  const std::vector<double> weights = internal::SlopeWeights(std::span(kTimes).first(2), 0);
  EXPECT_NEAR(weights[0] * Parabola(0.02) + weights[1] * Parabola(0.04),
              (Parabola(0.04) - Parabola(0.02)) / 0.02, 1e-12);
}

TEST(BendWeights, TellTheSecondDerivativeOfAParabola) {
  const std::array<double, 3> weights = internal::BendWeights(kTimes);
  double bend = 0;
  for (std::size_t k = 0; k < kTimes.size(); ++k) bend += weights[k] * Parabola(kTimes[k]);
  EXPECT_NEAR(bend, 6, 1e-9);
}

}  // namespace
}  // namespace plumbline
