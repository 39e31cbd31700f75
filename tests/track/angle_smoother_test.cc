#include "track/angle_smoother.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <stdexcept>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kSigma_rad = 1e-4;

// A wheel at about 3.6 rad/s, 50 frames a second with a few lost: its speed swings by 5 % once a
// second, or its jerk is white noise as the model has it.
struct Turning {
  std::vector<double> time_s, truth_rad, speed_rad_s, angle_rad, sigma_rad;

  explicit Turning(unsigned seed, int frames = 60, bool as_modelled = false) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> n(0, 1);
    double angle = 2, speed = 3.6, acceleration = 0.5;
    for (int f = 0; f < frames; ++f) {
      const double t = 0.02 * f, w = 2 * std::numbers::pi;
      if (f != 11 && f != 12 && f != 30) {
        time_s.push_back(t);
        truth_rad.push_back(as_modelled ? angle : 2 + 3.6 * t - 0.18 / w * std::cos(w * t));
        speed_rad_s.push_back(as_modelled ? speed : 3.6 + 0.18 * std::sin(w * t));
        sigma_rad.push_back(kSigma_rad * (1 + 0.5 * std::sin(f)));
        angle_rad.push_back(truth_rad.back() + sigma_rad.back() * n(rng));
      }
      constexpr int kParts = 50;
      constexpr double kPart_s = 0.02 / kParts, kJerk_rad_s25 = 5;
      for (int part = 0; part < kParts; ++part) {
        angle += kPart_s * (speed + kPart_s / 2 * acceleration);
        speed += kPart_s * acceleration;
        acceleration += kJerk_rad_s25 * std::sqrt(kPart_s) * n(rng);
      }
    }
  }
  std::size_t size() const { return time_s.size(); }
  SmoothedAngles Smoothed(const AngleSmootherOptions& options = {}) const {
    return SmoothAngles(time_s, angle_rad, sigma_rad, {}, options);
  }
};

// 20 frames in which the wheel speeds up and slows down again, with angles as sure as images give
// them: the last ones are no outliers because the first ones turned evenly.
TEST(AngleSmoother, AChangeOfSpeedIsNoOutlier) {
  std::mt19937 rng(4);
  std::normal_distribution<double> n(0, 1);
  constexpr double kSure_rad = 1e-6;
  std::vector<double> time_s, truth_rad, angle_rad;
  for (int f = 0; f < 20; ++f) {
    const double t = 0.02 * f, w = 2 * std::numbers::pi;
    time_s.push_back(t);
    truth_rad.push_back(3.6 * t - 0.514 / w * std::cos(w * t));
    angle_rad.push_back(truth_rad.back() + kSure_rad * n(rng));
  }
  const std::vector<double> sigma_rad(20, kSure_rad);
  const SmoothedAngles smooth = SmoothAngles(time_s, angle_rad, sigma_rad, {}, {});
  for (std::size_t f = 0; f < time_s.size(); ++f) {
    EXPECT_FALSE(smooth.frames[f].outlier) << f;
    EXPECT_LT(std::abs(smooth.frames[f].angle_rad - truth_rad[f]), 5 * kSure_rad) << f;
  }
}

// The more surely angles are known, the less a model of white jerk leads on to the last one.
TEST(AngleSmoother, AChangeOfSpeedAtTheEndIsNoOutlier) {
  std::mt19937 rng(4);
  std::normal_distribution<double> n(0, 1);
  constexpr double kSure_rad = 1e-6;
  for (int frames = 10; frames < 30; ++frames) {
    std::vector<double> time_s, truth_rad, angle_rad;
    for (int f = 0; f < frames; ++f) {
      const double t = 0.02 * f, w = 2 * std::numbers::pi;
      time_s.push_back(t);
      truth_rad.push_back(3.6 * t - 1.03 / w * std::cos(w * t) + 0.05 * std::sin(w * t));
      angle_rad.push_back(truth_rad.back() + kSure_rad * n(rng));
    }
    const std::vector<double> sigma_rad(time_s.size(), kSure_rad);
    const SmoothedAngles smooth = SmoothAngles(time_s, angle_rad, sigma_rad, {}, {});
    for (const std::size_t f : {std::size_t{0}, time_s.size() - 1}) {
      EXPECT_FALSE(smooth.frames[f].outlier) << f << " of " << frames;
      EXPECT_LT(std::abs(smooth.frames[f].angle_rad - truth_rad[f]), 5 * kSure_rad);
    }
  }
}

TEST(AngleSmoother, SigmasAreConsistent) {
  double angle = 0, speed = 0, turn = 0, inside = 0, count = 0, error = 0, raw = 0;
  constexpr int kDraws = 60;
  for (unsigned seed = 1; seed <= kDraws; ++seed) {
    const Turning wheel(seed, 60, true);
    const SmoothedAngles smooth = wheel.Smoothed();
    for (std::size_t i = 0; i < wheel.size(); ++i) {
      const SmoothedAngle& s = smooth.frames[i];
      const double off = s.angle_rad - wheel.truth_rad[i];
      const double fast = s.speed_rad_s - wheel.speed_rad_s[i];
      angle += std::pow(off / s.sigma_angle_rad, 2);
      speed += std::pow(fast / s.sigma_speed_rad_s, 2);
      if (i > 0) {
        const double first = smooth.frames[0].angle_rad - wheel.truth_rad[0];
        turn += std::pow((off - first) / s.sigma_turn_rad, 2);
      }
      inside += std::abs(off) < 1.96 * s.sigma_angle_rad ? 1 : 0;
      error += off * off;
      raw += std::pow(wheel.angle_rad[i] - wheel.truth_rad[i], 2);
      count += 1;
    }
  }
  EXPECT_NEAR(angle / count, 1, 0.1);
  EXPECT_NEAR(speed / count, 1, 0.2);
  EXPECT_NEAR(turn / count, 1, 0.4);  // all of a draw have the first frame's error in common
  EXPECT_GT(inside / count, 0.93);
  EXPECT_LT(inside / count, 0.97);
  EXPECT_LT(std::sqrt(error / raw), 0.7);
}

// Without a change of acceleration the angles are those of a parabola, and what two of them have in
// common drops out of the turn between them.
TEST(AngleSmoother, TurnsSinceTheFirstFrameAreAsSureAsAParabolaIs) {
  constexpr int kFrames = 9;
  std::vector<double> time_s, angle_rad;
  for (int f = 0; f < kFrames; ++f) {
    time_s.push_back(f);
    angle_rad.push_back(0.1 * f + (f % 2 == 0 ? 1e-5 : -1e-5));
  }
  const std::vector<double> sigma_rad(kFrames, kSigma_rad);
  const SmoothedAngles smooth = SmoothAngles(time_s, angle_rad, sigma_rad, {}, {.jerk_rad_s25 = 0});
  // Of the parabola through nine angles: cov = s^2 (X'X)^-1.
  Eigen::MatrixXd X(kFrames, 3);
  for (int f = 0; f < kFrames; ++f) X.row(f) << 1, f, f * f;
  const Eigen::Matrix3d cov = kSigma_rad * kSigma_rad * (X.transpose() * X).inverse();
  for (int f = 1; f < kFrames; ++f) {
    const Eigen::RowVector3d turned = X.row(f) - X.row(0);
    const double sigma = std::sqrt((turned * cov * turned.transpose()).value());
    EXPECT_NEAR(smooth.frames[static_cast<std::size_t>(f)].sigma_turn_rad, sigma, 1e-3 * sigma)
        << f;
  }
  EXPECT_EQ(smooth.frames[0].sigma_turn_rad, 0);
}

TEST(AngleSmoother, MarksWhatTheOthersContradictAndBridgesIt) {
  Turning wheel(5);
  wheel.angle_rad[20] += 12 * kSigma_rad;
  wheel.angle_rad[21] -= 300 * kSigma_rad;
  wheel.angle_rad[0] += 40 * kSigma_rad;
  wheel.angle_rad[40] = kNone;
  const SmoothedAngles smooth = wheel.Smoothed();
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    const SmoothedAngle& s = smooth.frames[i];
    EXPECT_EQ(s.outlier, i == 0 || i == 20 || i == 21) << i;
    EXPECT_NEAR(s.angle_rad, wheel.truth_rad[i], 4 * s.sigma_angle_rad) << i;
    if (s.outlier || i == 40) {
      EXPECT_EQ(s.lean, 1);
    } else {
      EXPECT_GT(s.lean, 0.1);
      EXPECT_LT(s.lean, 0.98);
    }
  }
  EXPECT_GT(smooth.frames[0].sigma_angle_rad, 2 * smooth.frames[30].sigma_angle_rad);
}

TEST(AngleSmoother, LeanIsOneLessTheDerivativeByTheFramesOwnAngle) {
  Turning wheel(3);
  AngleSmootherOptions options;
  options.jerk_rad_s25 = wheel.Smoothed().jerk_rad_s25;
  wheel.angle_rad = wheel.truth_rad;  // no scatter to be estimated anew
  Eigen::MatrixXd along = Eigen::MatrixXd::Zero(1, static_cast<Eigen::Index>(wheel.size()));
  for (const Eigen::Index at : {Eigen::Index{0}, Eigen::Index{1}, Eigen::Index{25}}) {
    along.setZero();
    along(0, at) = 1;
    const SmoothedAngles smooth =
        SmoothAngles(wheel.time_s, wheel.angle_rad, wheel.sigma_rad, along, options);
    const SmoothedAngle& s = smooth.frames[static_cast<std::size_t>(at)];
    EXPECT_NEAR(smooth.angle_along_rad(0, at), 1 - s.lean, 1e-4) << at;
    // The smoother is linear: a change of one angle goes through it as told.
    Turning other = wheel;
    const double change = kSigma_rad / 2;
    other.angle_rad[static_cast<std::size_t>(at)] += change;
    const SmoothedAngles moved = other.Smoothed(options);
    for (std::size_t i = 0; i < wheel.size(); ++i) {
      const auto column = static_cast<Eigen::Index>(i);
      EXPECT_NEAR(moved.frames[i].angle_rad - smooth.frames[i].angle_rad,
                  change * smooth.angle_along_rad(0, column), 1e-4 * change);
      EXPECT_NEAR(moved.frames[i].speed_rad_s - smooth.frames[i].speed_rad_s,
                  change * smooth.speed_along_rad_s(0, column), 1e-2 * change);
    }
  }
}

TEST(AngleSmoother, TellsThatAnglesScatterMoreThanTheyClaim) {
  Turning wheel(8, 200);
  for (double& sigma : wheel.sigma_rad) sigma /= 3;
  const SmoothedAngles smooth = wheel.Smoothed();
  EXPECT_NEAR(smooth.scatter, 3, 0.5);
  double chi2 = 0;
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    chi2 += std::pow(
        (smooth.frames[i].angle_rad - wheel.truth_rad[i]) / smooth.frames[i].sigma_angle_rad, 2);
  }
  EXPECT_LT(chi2 / static_cast<double>(wheel.size()), 2);
}

TEST(AngleSmoother, LeavesFewFramesAsTheyAre) {
  for (const int frames : {1, 2, 3}) {
    const Turning wheel(2, frames);
    const SmoothedAngles smooth = wheel.Smoothed();
    for (std::size_t i = 0; i < wheel.size(); ++i) {
      EXPECT_NEAR(smooth.frames[i].angle_rad, wheel.angle_rad[i], 1e-3 * kSigma_rad);
      EXPECT_NEAR(smooth.frames[i].sigma_angle_rad, wheel.sigma_rad[i], 0.01 * kSigma_rad);
      EXPECT_LT(smooth.frames[i].lean, 0.01);
    }
  }
  EXPECT_TRUE(SmoothAngles({}, {}, {}, {}).frames.empty());
}

TEST(AngleSmoother, RefusesWhatMakesNoSense) {
  const std::vector<double> t = {0, 1, 1}, z = {0, 0, 0}, s = {1, 1, 1}, zero = {1, 0, 1};
  EXPECT_THROW((void)SmoothAngles(t, z, s, {}), std::invalid_argument);
  const std::vector<double> grows = {0, 1, 2};
  EXPECT_THROW((void)SmoothAngles(grows, z, zero, {}), std::invalid_argument);
  EXPECT_THROW((void)SmoothAngles(grows, std::vector<double>{0}, s, {}), std::invalid_argument);
  AngleSmootherOptions options;
  options.jerk_rad_s25 = -1;
  EXPECT_THROW((void)SmoothAngles(grows, z, s, {}, options), UsageError);
}

}  // namespace
}  // namespace plumbline
