#pragma once

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cstring>
#include <functional>
#include <vector>

#include "match/correlation_seed.h"
#include "tests/support/rendered_speckle.h"

namespace plumbline::testing {

// x goes to about + map (x - about) + shift.
struct Motion {
  Eigen::Matrix2d map = Eigen::Matrix2d::Identity();
  Eigen::Vector2d shift_px{0, 0};
  Eigen::Vector2d about_px{0, 0};

  static Motion Shift(double x, double y) { return {Eigen::Matrix2d::Identity(), {x, y}, {0, 0}}; }
  static Motion Turn(double degrees, const Eigen::Vector2d& about_px) {
    return {Eigen::Rotation2Dd(degrees * 3.14159265358979 / 180).toRotationMatrix(),
            {3.3, -2.6},
            about_px};
  }
  Eigen::Vector2d Apply(const Eigen::Vector2d& x) const {
    return about_px + map * (x - about_px) + shift_px;
  }
  Eigen::Vector2d Undo(const Eigen::Vector2d& x) const {
    return about_px + map.inverse() * (x - shift_px - about_px);
  }
};

struct ImagePair {
  GrayImage reference, deformed;
};

inline ImagePair RenderMoved(ImageSize size, const Motion& motion,
                             const RenderedSpeckleOptions& options = {}, double noise_grey = 2) {
  return {
      RenderSpeckle(
          size, [](const Eigen::Vector2d& x) { return x; }, noise_grey, 11, options),
      RenderSpeckle(
          size, [&](const Eigen::Vector2d& x) { return motion.Undo(x); }, noise_grey, 12, options)};
}

// A part inside a circle of the reference that moves over a background at rest, which wears another
// piece of the speckle.
struct PartOnBackground {
  Eigen::Vector2d centre_px{0, 0};
  double radius_px = 0;
  Motion motion;

  bool Holds(const Eigen::Vector2d& x) const { return (x - centre_px).norm() < radius_px; }
  ImagePair Render(ImageSize size) const {
    const Eigen::Vector2d elsewhere(5000, 3000);
    return {RenderSpeckle(
                size,
                [&](const Eigen::Vector2d& x) -> Eigen::Vector2d {
                  return Holds(x) ? x : x + elsewhere;
                },
                2, 11),
            RenderSpeckle(
                size,
                [&](const Eigen::Vector2d& x) -> Eigen::Vector2d {
                  const Eigen::Vector2d before = motion.Undo(x);
                  return Holds(before) ? before : x + elsewhere;
                },
                2, 12)};
  }
};

struct SeedErrors {
  int count = 0;
  double largest_px = 0;        // of the displacements
  double largest_gradient = 0;  // of any component
};

inline SeedErrors ErrorsOf(const std::vector<CorrelationSeed>& seeds, const Motion& motion) {
  SeedErrors errors;
  for (const CorrelationSeed& seed : seeds) {
    ++errors.count;
    const Eigen::Vector2d there = seed.reference_px + seed.displacement_px;
    errors.largest_px =
        std::max(errors.largest_px, (there - motion.Apply(seed.reference_px)).norm());
    const Eigen::Matrix2d gradient = motion.map - Eigen::Matrix2d::Identity();
    errors.largest_gradient =
        std::max(errors.largest_gradient, (seed.gradient - gradient).cwiseAbs().maxCoeff());
  }
  return errors;
}

// What a seed is for: displacement to a pixel, gradient to 0.1.
inline void ExpectGood(const std::vector<CorrelationSeed>& seeds, const Motion& motion,
                       int least_count) {
  const SeedErrors errors = ErrorsOf(seeds, motion);
  EXPECT_GE(errors.count, least_count);
  EXPECT_LT(errors.largest_px, 1);
  EXPECT_LT(errors.largest_gradient, 0.1);
  for (const CorrelationSeed& seed : seeds) {
    EXPECT_GT(seed.score, 0.6);
    EXPECT_LE(seed.score, 1.0001);
  }
}

inline bool SameBits(const std::vector<CorrelationSeed>& a, const std::vector<CorrelationSeed>& b) {
  const auto same = [](const CorrelationSeed& x, const CorrelationSeed& y) {
    return x.reference_px == y.reference_px && x.displacement_px == y.displacement_px &&
           x.gradient == y.gradient && x.score == y.score;
  };
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), same);
}

inline GrayImage Uniform(ImageSize size, int grey) {
  return {Image<std::uint16_t>(size, static_cast<std::uint16_t>(grey)), 8};
}

// The message of the error that the call throws, or "" where it throws none of that type.
template <typename Error, typename Call>
std::string MessageOf(const Call& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

}  // namespace plumbline::testing
