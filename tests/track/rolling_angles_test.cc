#include "track/rolling_angles.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr double kSigma_rad = 1e-4, kBottom_rad = 0.04, kHalf_rad = 0.38, kHalf_mm = 80;

// A surface that is stretched evenly to both sides of the bottom, and sheared by as much as `even`.
double AheadOf(double place_rad, double y_mm, double even) {
  const double u = (place_rad - kBottom_rad) / 0.15, across = 1 - std::pow(y_mm / 150, 2);
  return across * (0.008 * u * std::exp(-u * u / 2) + even * std::exp(-std::pow(u + 0.5, 2)));
}

struct Rolling {
  std::vector<std::vector<RollingObservation>> frames;
  std::vector<double> truth_rad;

  // obstacle_rad: what something on the ground adds to the points over it.
  explicit Rolling(unsigned seed, double even = 0, double obstacle_rad = 0, int count = 12,
                   int points = 300) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> n(0, 1);
    std::uniform_real_distribution<double> place(-kHalf_rad, kHalf_rad), y(-kHalf_mm, kHalf_mm);
    for (int f = 0; f < count; ++f) {
      truth_rad.push_back(1 + 0.07 * f);
      frames.emplace_back();
      for (int i = 0; i < points; ++i) {
        RollingObservation o;
        o.place_rad = place(rng);
        o.y_mm = y(rng);
        o.sigma_rad = kSigma_rad * (1 + 0.3 * std::sin(i));
        o.block = i;
        const double u = o.place_rad - kBottom_rad;
        o.radial_mm = -18 * std::exp(-u * u / 0.06);
        o.psi_rad = truth_rad.back() - AheadOf(o.place_rad, o.y_mm, even) + o.sigma_rad * n(rng);
        const double over = 0.4 - 0.07 * f;  // where it lies by now
        if (std::abs(o.place_rad - over) < 0.06) o.psi_rad += obstacle_rad * (1 + 0.3 * n(rng));
        frames.back().push_back(o);
      }
    }
  }
};

TEST(RollingAngles, AreThoseOfTheWheelWhateverTheDeformation) {
  double nees = 0, inside = 0, count = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Rolling wheel(seed);
    const RollingAngles found = FindRollingAngles(wheel.frames, {});
    EXPECT_NEAR(found.centre_rad, kBottom_rad, 0.01);
    EXPECT_NEAR(found.scatter, 1, 0.1);
    double common = 0;
    for (std::size_t f = 0; f < 12; ++f) {
      common += (found.frames[f].angle_rad - wheel.truth_rad[f]) / 12;
    }
    // Evenly stretched, it has no even part.
    EXPECT_NEAR(common, 0, 2e-4);
    EXPECT_LT(std::abs(common), 3 * found.sigma_common_rad + 1e-4);
    for (std::size_t f = 1; f < 12; ++f) {
      const RollingAngle &now = found.frames[f], &first = found.frames[0];
      const double off =
          (now.angle_rad - first.angle_rad) - (wheel.truth_rad[f] - wheel.truth_rad[0]);
      const double sigma = std::hypot(now.sigma_rad, first.sigma_rad);
      nees += off * off / (sigma * sigma);
      inside += std::abs(off) < 1.96 * sigma ? 1 : 0;
      count += 1;
      EXPECT_NEAR(now.sigma_rad, kSigma_rad / std::sqrt(300), 0.3 * kSigma_rad / std::sqrt(300));
    }
  }
  EXPECT_NEAR(nees / count, 1, 0.35);
  EXPECT_GT(inside / count, 0.9);
}

TEST(RollingAngles, ShearMovesAllFramesAlikeAndIsTold) {
  const Rolling wheel(3, 0.004);
  const RollingAngles found = FindRollingAngles(wheel.frames, {});
  const double common = found.frames[0].angle_rad - wheel.truth_rad[0];
  EXPECT_GT(std::abs(common), 2e-4);
  EXPECT_LT(std::abs(common), 2 * found.sigma_common_rad);
  EXPECT_LT(found.sigma_common_rad, 0.02);
  for (std::size_t f = 0; f < wheel.frames.size(); ++f) {
    EXPECT_NEAR(found.frames[f].angle_rad - wheel.truth_rad[f], common, 4e-5);
  }
  // Its mean even part is zero by definition, and its shape that of the surface.
  for (const double y : {-40.0, 0.0, 40.0}) {
    for (const double place : {-0.2, 0.0, 0.15}) {
      EXPECT_NEAR(found.Ahead(place, y) - AheadOf(place, y, 0.004), common, 1.5e-4);
    }
  }
  EXPECT_TRUE(std::isnan(found.Ahead(1, 0)));
  EXPECT_TRUE(std::isnan(found.Ahead(0, 200)));
}

TEST(RollingAngles, AnObstacleUnderAPartOfTheViewDoesNotTurnTheWheel) {
  const Rolling wheel(4, 0, 0.01);
  const RollingAngles found = FindRollingAngles(wheel.frames, {});
  for (std::size_t f = 1; f < wheel.frames.size(); ++f) {
    const double off = (found.frames[f].angle_rad - found.frames[0].angle_rad) -
                       (wheel.truth_rad[f] - wheel.truth_rad[0]);
    EXPECT_NEAR(off, 0, 5e-5) << f;  // 0.003 degrees; the mean of the points would be 0.001 rad off
    EXPECT_GT(found.frames[f].used_share, 0.5);
    EXPECT_LT(found.frames[f].used_share, 0.97);
  }
}

TEST(RollingAngles, ABarThatDrawsTheSurfaceInDoesNotTurnTheWheel) {
  // All before it is drawn on and all behind it held back, by a degree, fixed to the ground.
  constexpr double kDrawn_rad = 0.018, kHalfWay_rad = 0.05;
  Rolling wheel(7, 0, 0, 16, 900);
  std::vector<double> times;
  for (std::size_t f = 0; f < wheel.frames.size(); ++f) {
    times.push_back(0.02 * static_cast<double>(f));
    const double over = 0.6 - 0.07 * static_cast<double>(f);
    for (RollingObservation& o : wheel.frames[f]) {
      const double u = std::clamp((o.place_rad - over) / kHalfWay_rad, -1.0, 1.0);
      o.psi_rad += kDrawn_rad * u * (3 - u * u) / 2;
    }
  }
  const RollingAngles found = FindRollingAngles(wheel.frames, {}, {}, times);
  EXPECT_FALSE(found.steady);
  for (std::size_t f = 1; f < wheel.frames.size(); ++f) {
    const double off = (found.frames[f].angle_rad - found.frames[0].angle_rad) -
                       (wheel.truth_rad[f] - wheel.truth_rad[0]);
    EXPECT_NEAR(off, 0, 4e-4) << f;
    EXPECT_LT(std::abs(off), 3 * found.sigma_common_rad) << f;
  }
  EXPECT_TRUE(FindRollingAngles(Rolling(7).frames, {}).steady);
}

TEST(RollingAngles, FollowTheModes) {
  const Rolling wheel(5);
  std::vector<Eigen::MatrixXf> along;
  for (std::size_t f = 0; f < wheel.frames.size(); ++f) {
    const auto count = static_cast<Eigen::Index>(wheel.frames[f].size());
    along.push_back(Eigen::MatrixXf::Zero(count, 3));
    for (Eigen::Index i = 0; i < count; ++i) {
      const RollingObservation& o = wheel.frames[f][static_cast<std::size_t>(i)];
      // Of all points of a frame; of places; evenly about the bottom.
      along[f](i, 0) = 1e-3F * static_cast<float>(f);
      along[f](i, 1) = static_cast<float>(0.01 * (o.place_rad - kBottom_rad));
      along[f](i, 2) = static_cast<float>(-1e-5 * o.y_mm);
    }
  }
  const RollingAngles found = FindRollingAngles(wheel.frames, along);
  ASSERT_EQ(found.along_modes.rows(), 3);
  for (Eigen::Index f = 1; f < found.along_modes.cols(); ++f) {
    const Eigen::Vector3d change = found.along_modes.col(f) - found.along_modes.col(0);
    EXPECT_NEAR(change[0], 1e-3 * static_cast<double>(f), 1e-6);
    EXPECT_NEAR(change[1], 0, 1e-6);
    EXPECT_NEAR(change[2], 0, 1e-6);
  }
  EXPECT_NEAR(found.along_modes(1, 0), 0, 1e-4);
}

TEST(RollingAngles, SayWhereNothingIsKnown) {
  Rolling wheel(6);
  wheel.frames[3].clear();
  const RollingAngles found = FindRollingAngles(wheel.frames, {});
  EXPECT_TRUE(std::isnan(found.frames[3].angle_rad));
  EXPECT_TRUE(std::isfinite(found.frames[4].angle_rad));
  const std::vector<std::vector<RollingObservation>> none(2);
  EXPECT_TRUE(std::isnan(FindRollingAngles(none, {}).frames[1].angle_rad));
  RollingAnglesOptions options;
  options.knot_mm = 0;
  EXPECT_THROW((void)FindRollingAngles(wheel.frames, {}, options), UsageError);
  const std::vector<Eigen::MatrixXf> along(1);
  EXPECT_THROW((void)FindRollingAngles(wheel.frames, along), std::invalid_argument);
  const std::vector<double> times(2);
  EXPECT_THROW((void)FindRollingAngles(wheel.frames, {}, {}, times), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
