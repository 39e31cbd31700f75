#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "track/angle_smoother.h"

// The smoother with turns that something else measures, and angles whose errors drift.
namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kJerk_rad_s25 = 5, kSigma_rad = 1e-4, kDrift_rad = 6e-4, kTurnSigma_rad = 5e-5;

// As modelled: a wheel at about 3.6 rad/s, unevenly spaced frames, the surface drawn along bit by
// bit, and an encoder.
struct Turning {
  std::vector<double> time_s, truth_rad, speed_rad_s, angle_rad, sigma_rad;
  AngleTurns turns;

  explicit Turning(unsigned seed, int frames = 40) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> n(0, 1);
    double angle = 2, speed = 3.6, acceleration = 0.5, drift = 0, time = 0;
    for (int f = 0; f < frames; ++f) {
      time_s.push_back(time);
      truth_rad.push_back(angle);
      speed_rad_s.push_back(speed);
      sigma_rad.push_back(kSigma_rad * (1 + 0.5 * std::sin(f)));
      angle_rad.push_back(angle + drift + sigma_rad.back() * n(rng));
      if (f + 1 == frames) break;
      const double frame_s = f % 7 == 3 ? 0.05 : 0.02;
      constexpr int kParts = 50;
      const double part_s = frame_s / kParts;
      for (int part = 0; part < kParts; ++part) {
        angle += part_s * (speed + part_s / 2 * acceleration);
        speed += part_s * acceleration;
        acceleration += kJerk_rad_s25 * std::sqrt(part_s) * n(rng);
      }
      time += frame_s;
      turns.sigma_rad.push_back(kTurnSigma_rad * (1 + 0.3 * std::cos(f)));
      turns.turn_rad.push_back(angle - truth_rad.back() + turns.sigma_rad.back() * n(rng));
      turns.drift_rad.push_back(f % 5 == 0 ? 0 : kDrift_rad);
      drift += turns.drift_rad.back() * n(rng);
    }
  }
  std::size_t size() const { return time_s.size(); }
  SmoothedAngles Smoothed(const AngleSmootherOptions& options = {}) const {
    return SmoothAngles(time_s, angle_rad, sigma_rad, {}, options, turns);
  }
};

// The same by covariances in place of states: a parabola that is free, plus three times integrated
// white noise of the density q, cov(s, t) = q int_0^min (s - u)^2 (t - u)^2 / 4 du (universal
// kriging).
struct Kriged {
  Eigen::VectorXd angle_rad, sigma_rad;

  Kriged(const Turning& wheel, double q) {
    const auto n = static_cast<Eigen::Index>(wheel.size());
    const auto motion = [&](Eigen::Index i, Eigen::Index j) {
      const double s = wheel.time_s[static_cast<std::size_t>(std::max(i, j))],
                   t = wheel.time_s[static_cast<std::size_t>(std::min(i, j))], d = s - t;
      return q / 4 * (std::pow(t, 5) / 5 + d * std::pow(t, 4) / 2 + d * d * std::pow(t, 3) / 3);
    };
    Eigen::MatrixXd cov(n, n), basis(n, 3);
    std::vector<Eigen::RowVectorXd> rows;  // of what is observed in the angles
    std::vector<double> values, variances;
    std::vector<Eigen::Index> frame_of;
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto f = static_cast<std::size_t>(i);
      for (Eigen::Index j = 0; j < n; ++j) cov(i, j) = motion(i, j);
      basis.row(i) << 1, wheel.time_s[f], wheel.time_s[f] * wheel.time_s[f];
      if (std::isfinite(wheel.angle_rad[f])) {
        rows.push_back(Eigen::RowVectorXd::Unit(n, i));
        values.push_back(wheel.angle_rad[f]);
        variances.push_back(wheel.sigma_rad[f] * wheel.sigma_rad[f]);
        frame_of.push_back(i);
      }
      if (i + 1 < n && std::isfinite(wheel.turns.turn_rad[f])) {
        rows.push_back(Eigen::RowVectorXd::Unit(n, i + 1) - Eigen::RowVectorXd::Unit(n, i));
        values.push_back(wheel.turns.turn_rad[f]);
        variances.push_back(wheel.turns.sigma_rad[f] * wheel.turns.sigma_rad[f]);
        frame_of.push_back(-1);
      }
    }
    const auto m = static_cast<Eigen::Index>(rows.size());
    Eigen::MatrixXd A(m, n), S(m, m);
    Eigen::VectorXd y(m);
    for (Eigen::Index k = 0; k < m; ++k) {
      A.row(k) = rows[static_cast<std::size_t>(k)];
      y[k] = values[static_cast<std::size_t>(k)];
    }
    S = A * cov * A.transpose();
    for (Eigen::Index k = 0; k < m; ++k) {
      S(k, k) += variances[static_cast<std::size_t>(k)];
      for (Eigen::Index l = 0; l < m; ++l) {
        const Eigen::Index a = frame_of[static_cast<std::size_t>(k)],
                           b = frame_of[static_cast<std::size_t>(l)];
        for (Eigen::Index i = 0; i < std::min(a, b); ++i) {
          S(k, l) += std::pow(wheel.turns.drift_rad[static_cast<std::size_t>(i)], 2);
        }
      }
    }
    const Eigen::MatrixXd X = A * basis, inverse = S.inverse(), C = cov * A.transpose();
    const Eigen::Matrix3d free = (X.transpose() * inverse * X).inverse();
    const Eigen::Vector3d beta = free * X.transpose() * inverse * y;
    angle_rad = basis * beta + C * inverse * (y - X * beta);
    const Eigen::MatrixXd left = basis - C * inverse * X;
    sigma_rad =
        (cov - C * inverse * C.transpose() + left * free * left.transpose()).diagonal().cwiseSqrt();
  }
};

TEST(AngleTurns, SmoothAsCovariancesTellIt) {
  Turning wheel(3, 12);
  wheel.angle_rad[4] = kNone;
  wheel.turns.turn_rad[7] = kNone;
  AngleSmootherOptions options;
  options.jerk_rad_s25 = kJerk_rad_s25;
  options.outlier_sigmas = 1e3;
  const SmoothedAngles smooth = wheel.Smoothed(options);
  ASSERT_EQ(smooth.scatter, 1);
  const Kriged kriged(wheel, kJerk_rad_s25 * kJerk_rad_s25);
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    EXPECT_NEAR(smooth.frames[i].angle_rad, kriged.angle_rad[at], 1e-4 * kriged.sigma_rad[at]) << i;
    EXPECT_NEAR(smooth.frames[i].sigma_angle_rad / kriged.sigma_rad[at], 1, 1e-4) << i;
  }
}

// Mean squared errors in sigmas, shares within 1.96 of them, and root mean squares.
struct Errors {
  double angle = 0, speed = 0, inside = 0, rms_rad = 0, rms_without_rad = 0;
};

Errors ErrorsOver(unsigned draws, const AngleSmootherOptions& options) {
  Errors sum;
  double count = 0;
  for (unsigned seed = 1; seed <= draws; ++seed) {
    Turning wheel(seed);
    wheel.turns.turn_rad[20] = kNone;
    const SmoothedAngles smooth = wheel.Smoothed(options);
    for (std::size_t i = 0; i < wheel.size(); ++i) {
      const SmoothedAngle& s = smooth.frames[i];
      const double off = s.angle_rad - wheel.truth_rad[i];
      sum.angle += std::pow(off / s.sigma_angle_rad, 2);
      sum.speed += std::pow((s.speed_rad_s - wheel.speed_rad_s[i]) / s.sigma_speed_rad_s, 2);
      sum.inside += std::abs(off) < 1.96 * s.sigma_angle_rad ? 1 : 0;
      sum.rms_rad += off * off;
      sum.rms_without_rad += std::pow(wheel.angle_rad[i] - wheel.truth_rad[i], 2);
      count += 1;
    }
  }
  return {sum.angle / count, sum.speed / count, sum.inside / count, std::sqrt(sum.rms_rad / count),
          std::sqrt(sum.rms_without_rad / count)};
}

TEST(AngleTurns, SigmasAreConsistent) {
  AngleSmootherOptions options;
  options.jerk_rad_s25 = kJerk_rad_s25;
  const Errors errors = ErrorsOver(2000, options);
  EXPECT_NEAR(errors.angle, 1, 0.1);
  EXPECT_NEAR(errors.speed, 1, 0.1);
  EXPECT_GT(errors.inside, 0.93);
  EXPECT_LT(errors.inside, 0.97);
  EXPECT_LT(errors.rms_rad, 0.15 * errors.rms_without_rad);
}

// The errors of all frames of a draw go together, so that few draws tell those of the angle less
// well than those of the speed.
TEST(AngleTurns, SigmasAreConsistentWithTheNoiseOfTheMotionEstimated) {
  const Errors errors = ErrorsOver(80, {});
  EXPECT_NEAR(errors.angle, 1, 0.35);
  EXPECT_NEAR(errors.speed, 1, 0.15);
}

TEST(AngleTurns, DoNotMatterWhereTheAnglesAreSurer) {
  Turning wheel(2);
  wheel.turns.drift_rad.clear();
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    wheel.angle_rad[i] = wheel.truth_rad[i];
    wheel.sigma_rad[i] = kTurnSigma_rad / 10;
  }
  wheel.turns.along_rad.resize(1, static_cast<Eigen::Index>(wheel.turns.turn_rad.size()));
  wheel.turns.along_rad.setConstant(kTurnSigma_rad);
  const SmoothedAngles smooth = wheel.Smoothed();
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    EXPECT_NEAR(smooth.frames[i].angle_rad, wheel.truth_rad[i], kTurnSigma_rad / 10) << i;
    EXPECT_LT(std::abs(smooth.angle_along_turns_rad(0, static_cast<Eigen::Index>(i))),
              kTurnSigma_rad / 10);
  }
}

TEST(AngleTurns, TheirChangesGoThroughTheSmootherAsTheyDo) {
  Turning wheel(7, 20);
  AngleSmootherOptions options;
  options.jerk_rad_s25 = kJerk_rad_s25;
  // Without scatter, so that it is not estimated anew.
  for (std::size_t i = 0; i < wheel.size(); ++i) wheel.angle_rad[i] = wheel.truth_rad[i];
  for (std::size_t i = 0; i + 1 < wheel.size(); ++i) {
    wheel.turns.turn_rad[i] = wheel.truth_rad[i + 1] - wheel.truth_rad[i];
  }
  const auto pairs = static_cast<Eigen::Index>(wheel.turns.turn_rad.size());
  wheel.turns.along_rad.resize(2, pairs);
  for (Eigen::Index k = 0; k < pairs; ++k) {
    wheel.turns.along_rad.col(k) << 1e-5, 1e-5 * std::sin(static_cast<double>(k));
  }
  const SmoothedAngles smooth = wheel.Smoothed(options);
  for (Eigen::Index mode = 0; mode < 2; ++mode) {
    Turning moved = wheel;
    for (Eigen::Index k = 0; k < pairs; ++k) {
      moved.turns.turn_rad[static_cast<std::size_t>(k)] += wheel.turns.along_rad(mode, k);
    }
    const SmoothedAngles other = moved.Smoothed(options);
    for (std::size_t i = 0; i < wheel.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      EXPECT_NEAR(other.frames[i].angle_rad - smooth.frames[i].angle_rad,
                  smooth.angle_along_turns_rad(mode, at), 1e-9);
      EXPECT_NEAR(other.frames[i].speed_rad_s - smooth.frames[i].speed_rad_s,
                  smooth.speed_along_turns_rad_s(mode, at), 1e-7);
    }
  }
  // The angles tell next to nothing of the turns: the sum of all is followed.
  EXPECT_GT(smooth.angle_along_turns_rad(0, pairs), 0.9e-5 * static_cast<double>(pairs));
}

TEST(AngleTurns, OneThatTheOthersContradictDoesNotCount) {
  Turning wheel(5);
  wheel.turns.turn_rad[12] += 40 * kTurnSigma_rad;
  wheel.turns.turn_rad[13] -= 300 * kTurnSigma_rad;
  wheel.angle_rad[30] += 100 * kSigma_rad;
  const SmoothedAngles smooth = wheel.Smoothed();
  for (std::size_t i = 0; i < wheel.size(); ++i) {
    const SmoothedAngle& s = smooth.frames[i];
    EXPECT_EQ(s.turn_outlier, i == 12 || i == 13) << i;
    EXPECT_EQ(s.outlier, i == 30) << i;
    EXPECT_NEAR(s.angle_rad, wheel.truth_rad[i], 4 * s.sigma_angle_rad) << i;
  }
}

TEST(AngleTurns, WhatDriftsDoesNotAverageOut) {
  Turning wheel(9);
  wheel.turns.turn_rad.clear();
  wheel.turns.sigma_rad.clear();
  const SmoothedAngles smooth = wheel.Smoothed();
  EXPECT_LT(smooth.frames.front().sigma_angle_rad, 1.6 * kSigma_rad);
  EXPECT_GT(smooth.frames.back().sigma_angle_rad, 3 * kDrift_rad);
}

TEST(AngleTurns, RefuseWhatMakesNoSense) {
  const std::vector<double> t = {0, 1, 2}, z = {0, 0, 0}, s = {1, 1, 1};
  const auto refused = [&](const AngleTurns& turns) {
    EXPECT_THROW((void)SmoothAngles(t, z, s, {}, {}, turns), std::invalid_argument);
  };
  refused({.turn_rad = {0}, .sigma_rad = {1}, .drift_rad = {}, .along_rad = {}});
  refused({.turn_rad = {0, 0}, .sigma_rad = {1}, .drift_rad = {}, .along_rad = {}});
  refused({.turn_rad = {0, 0}, .sigma_rad = {1, 0}, .drift_rad = {}, .along_rad = {}});
  refused({.turn_rad = {}, .sigma_rad = {}, .drift_rad = {1, -1}, .along_rad = {}});
  refused({.turn_rad = {}, .sigma_rad = {}, .drift_rad = {}, .along_rad = Eigen::MatrixXd(1, 3)});
}

}  // namespace
}  // namespace plumbline
