#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/internal/disc_fit.h"
#include "tests/support/synthetic_board.h"

namespace plumbline {
namespace {

using internal::DiscFit;
using internal::Ellipse;
using internal::FitDisc;
using testing::SyntheticPhoto;

constexpr double kRadiusMm = 1;

// One disc, or ring, tilted, shaded and blurred, at a given place in the image.
SyntheticPhoto OneDisc(const Eigen::Vector2d& where_px, double radius_px, double tilt_deg,
                       bool ring) {
  SyntheticPhoto photo;
  // The edge is a ramp as wide as one of the renderer's samples, which would otherwise limit the
  // truth to 0.006 px.
  const double sample_mm = kRadiusMm / radius_px / 5;
  photo.albedo = [ring, sample_mm](const Eigen::Vector2d& p) {
    const auto outside = [&](double radius) {
      return std::clamp((p.norm() - radius) / sample_mm + 0.5, 0.0, 1.0);
    };
    const double white = outside(kRadiusMm);
    return ring ? std::max(white, 1 - outside(0.36 * kRadiusMm)) : white;
  };
  photo.size = {64, 64};
  photo.shading = {0.004, -0.003};
  photo.image_from_board =
      testing::BoardHomography({0, 0}, radius_px, 25, tilt_deg, 0.4 * tilt_deg, where_px, 60);
  return photo;
}

std::optional<DiscFit> FitOneDisc(const SyntheticPhoto& photo, bool ring) {
  Ellipse start;
  start.centre = photo.Map({0, 0}) + Eigen::Vector2d(0.4, -0.3);
  const double radius = (photo.Map({kRadiusMm, 0}) - photo.Map({0, 0})).norm();
  start.shape /= radius * radius;
  return FitDisc(photo.Render(), start, 1.7, ring);
}

class DiscBias : public ::testing::TestWithParam<std::tuple<double, double, bool>> {};

TEST_P(DiscBias, CentreIsTheCentroidOfTheDiscsImage) {
  const auto [radius_px, tilt_deg, ring] = GetParam();
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  double worst = 0;
  constexpr int kPhases = 9;
  for (int k = 0; k < kPhases; ++k) {
    const SyntheticPhoto photo =
        OneDisc({31.3 + k % 3 / 3.0, 32.1 + k / 3 / 3.0}, radius_px, tilt_deg, ring);
    const auto fit = FitOneDisc(photo, ring);
    ASSERT_TRUE(fit);
    const Eigen::Vector2d error =
        fit->ellipse.centre - testing::DiscCentroid(photo, {0, 0}, kRadiusMm);
    mean += error / kPhases;
    worst = std::max(worst, error.norm());
  }
  EXPECT_LT(mean.norm(), 0.002);
  EXPECT_LT(worst, 0.008);  // rounding to whole grey levels
}

INSTANTIATE_TEST_SUITE_P(
    SizesTiltsRings, DiscBias,
    ::testing::Values(std::tuple{6.0, 0.0, false}, std::tuple{6.0, 40.0, false},
                      std::tuple{14.0, 0.0, false}, std::tuple{14.0, 40.0, false},
                      std::tuple{14.0, 0.0, true}, std::tuple{14.0, 40.0, true}));

TEST(DiscFit, SigmaAgreesWithSampling) {
  SyntheticPhoto photo = OneDisc({31.3, 32.1}, 10, 30, false);
  photo.noise = 3;
  std::vector<Eigen::Vector2d> centres;
  Eigen::Matrix2d claimed = Eigen::Matrix2d::Zero();
  constexpr int kDraws = 300;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (int draw = 0; draw < kDraws; ++draw) {
    photo.seed = static_cast<std::uint64_t>(100 + draw);
    const auto fit = FitOneDisc(photo, false);
    ASSERT_TRUE(fit);
    centres.push_back(fit->ellipse.centre);
    claimed += fit->cov_px2 / kDraws;
    mean += fit->ellipse.centre / kDraws;
  }
  double nees = 0;
  for (const Eigen::Vector2d& c : centres) {
    nees += (c - mean).dot(claimed.inverse() * (c - mean)) / kDraws;
  }
  EXPECT_NEAR(nees, 2, 4 * std::sqrt(4.0 / kDraws));
}

TEST(DiscFit, RefusesADiscThatLeavesTheImage) {
  EXPECT_FALSE(FitOneDisc(OneDisc({8, 32}, 14, 0, false), false));
}

TEST(DiscFit, RefusesAFlatPatch) {
  GrayImage image{Image<std::uint16_t>({64, 64}, 90), 8};
  Ellipse start;
  start.centre = {32, 32};
  start.shape /= 100;
  EXPECT_FALSE(FitDisc(image, start, 1.7, false));
}

}  // namespace
}  // namespace plumbline
