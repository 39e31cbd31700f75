#include "track/rim_angles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <stdexcept>

#include "tests/support/consistency.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/track/tagged_wheel.h"
#include "track/right_flow.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::TaggedWheel;

constexpr double kDegrees = std::numbers::pi / 180;
constexpr double kNoise_px = 0.12;

TaggedWheel Rim() {
  TaggedWheel rim(24, 340, 15);
  for (WheelTag& tag : rim.wheel.tags.tags) tag.on_rim = true;
  return rim;
}

TEST(RimAngles, DerivativesAreThoseOfDifferences) {
  const TaggedWheel rim = Rim();
  const WheelTag& tag = rim.wheel.tags.tags[3];
  const double angle = TaggedWheel::MaterialAngleOf(tag) + 0.2;
  Eigen::VectorXd x(13);
  x[0] = angle;
  for (Eigen::Index k = 0; k < 4; ++k) {
    x.segment<3>(1 + 3 * k) = tag.corner_mm[static_cast<std::size_t>(k)];
  }
  const auto pixels = [&](const Eigen::VectorXd& at) -> Eigen::VectorXd {
    std::array<Eigen::Vector3d, 4> corners;
    for (Eigen::Index k = 0; k < 4; ++k) {
      corners[static_cast<std::size_t>(k)] = at.segment<3>(1 + 3 * k);
    }
    return ProjectTag(rim.wheel.rig, rim.wheel.axis, corners, at[0]).pixels;
  };
  const TagProjection there = ProjectTag(rim.wheel.rig, rim.wheel.axis, tag.corner_mm, angle);
  const Eigen::MatrixXd J = testing::NumericJacobian(pixels, x);
  EXPECT_LT((J.col(0) - there.d_angle).norm(), 1e-6 * there.d_angle.norm());
  EXPECT_LT((J.rightCols<12>() - there.d_corner).norm(), 1e-6 * there.d_corner.norm());
}

// Corners in the images and on the wheel are drawn anew: both parts of the sigma are needed.
TEST(RimAngles, AreWithinTheirSigmas) {
  TaggedWheel rim = Rim();
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> anywhere(0, 2 * std::numbers::pi);
  constexpr double kPlace_mm = 0.03;
  Consistency random_part, all;
  double squares = 0, freedoms = 0;
  for (int draw = 0; draw < 600; ++draw) {
    const double truth = anywhere(random);
    const StereoTags seen = rim.See(truth, kNoise_px, random);
    ASSERT_FALSE(seen.tags.empty());
    const RimAngle exact = RimAngleFinder(rim.wheel).Find(seen, truth + 0.03);
    ASSERT_TRUE(exact.found);
    random_part.Add(exact.angle_rad - truth, kNoise_px * exact.sigma_per_px_rad);
    squares += exact.squares_px2;
    freedoms += exact.freedoms;
    WheelReference measured = rim.wheel;
    for (WheelTag& tag : measured.tags.tags) {
      tag.cov_random_mm2 = kPlace_mm * kPlace_mm * WheelTag::Covariance::Identity();
      for (Eigen::Vector3d& corner : tag.corner_mm) {
        for (double& x : corner) x += kPlace_mm * normal(random);
      }
    }
    const RimAngle angle = RimAngleFinder(measured).Find(seen, truth - 0.03);
    ASSERT_TRUE(angle.found);
    all.Add(angle.angle_rad - truth,
            std::hypot(kNoise_px * angle.sigma_per_px_rad, angle.sigma_reference_rad));
  }
  random_part.Print("rim angle, noise, rad");
  all.Print("rim angle, rad");
  EXPECT_NEAR(random_part.nees(), 1, 4 * std::sqrt(2.0 / 600));
  EXPECT_NEAR(all.nees(), 1, 4 * std::sqrt(2.0 / 600));
  EXPECT_NEAR(std::sqrt(squares / freedoms), kNoise_px, 0.01 * kNoise_px);
}

TEST(RimAngles, MoveAlongTheModesAsWhenFoundAnew) {
  TaggedWheel rim = Rim();
  rim.AddModes();
  rim.AddFrames(1);
  WheelReference& wheel = rim.wheel;
  std::mt19937 random(4);
  std::normal_distribution<double> normal(0, 1);
  wheel.axis_along_modes << 1e-5, 2e-5, 2e-5, 0.02, 0, 1e-5, 0, -0.03, 0, -3e-5, 0, 0.05;
  for (WheelTag& tag : wheel.tags.tags) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      for (Eigen::Index i = 0; i < 12; ++i) tag.along_modes_mm(k, i) = 0.01 * normal(random);
    }
  }
  const StereoTags seen = rim.See(1.3, 0, random);
  const RimAngle angle = RimAngleFinder(wheel).Find(seen, 1.3);
  ASSERT_EQ(angle.along_modes_rad.size(), 3);
  for (Eigen::Index k = 0; k < 3; ++k) {
    WheelReference moved = wheel;
    moved.rig = wheel.rig.AlongMode(static_cast<int>(k));
    moved.axis = wheel.axis.Off(wheel.axis_along_modes.row(k).transpose());
    for (WheelTag& tag : moved.tags.tags) {
      for (Eigen::Index c = 0; c < 4; ++c) {
        tag.corner_mm[static_cast<std::size_t>(c)] +=
            tag.along_modes_mm.block<1, 3>(k, 3 * c).transpose();
      }
    }
    const double change = RimAngleFinder(moved).Find(seen, 1.3).angle_rad - angle.angle_rad;
    EXPECT_NEAR(angle.along_modes_rad[k], change, 0.01 * std::abs(change) + 1e-9) << k;
    EXPECT_GT(std::abs(change), 1e-7);
  }
}

TEST(RimAngles, AreNotMovedByModesThatMoveNoCamera) {
  TaggedWheel rim = Rim();
  rim.AddModes();
  rim.AddFrames(1);
  std::mt19937 random(5);
  const StereoTags seen = rim.See(0.3, 0, random);
  const RimAngle before = RimAngleFinder(rim.wheel).Find(seen, 0.3);
  const WheelReference late = WithDelayMode(rim.wheel, {.value_s = 2e-5, .sigma_s = 1e-6});
  const RimAngle after = RimAngleFinder(late).Find(seen, 0.3);
  ASSERT_TRUE(before.found && after.found);
  ASSERT_EQ(after.along_modes_rad.size(), before.along_modes_rad.size() + 1);
  EXPECT_EQ(after.along_modes_rad.head(before.along_modes_rad.size()), before.along_modes_rad);
  EXPECT_EQ(after.along_modes_rad[late.delay_mode], 0);
  EXPECT_EQ(after.angle_rad, before.angle_rad);
}

TEST(RimAngles, AreNoneWithoutTagsOnTheRim) {
  TaggedWheel rim = Rim();
  std::mt19937 random(5);
  const StereoTags seen = rim.See(1, 0, random);
  EXPECT_FALSE(RimAngleFinder(rim.wheel).Find({}, 1).found);
  // A turn off the truth that no step can make up.
  EXPECT_FALSE(RimAngleFinder(rim.wheel).Find(seen, 1.4).found);
  for (WheelTag& tag : rim.wheel.tags.tags) tag.on_rim = false;
  EXPECT_FALSE(RimAngleFinder(rim.wheel).Find(seen, 1).found);
}

// What a surface tells in frames of a wheel that turns by a degree a frame.
struct Recording {
  std::vector<double> truth, surface, sigma;
  std::vector<RimAngle> rim;
};

// twist(f): of the carcass in frame f. Every third frame sees no tag on the rim.
template <typename Twist>
Recording Record(const TaggedWheel& rim, const Twist& twist, double surface_sigma_rad, int frames,
                 std::mt19937& random) {
  std::normal_distribution<double> normal(0, 1);
  Recording out;
  const RimAngleFinder finder(rim.wheel);
  for (int f = 0; f < frames; ++f) {
    out.truth.push_back(0.3 + f * kDegrees);
    out.surface.push_back(out.truth.back() + twist(f) + surface_sigma_rad * normal(random));
    out.sigma.push_back(surface_sigma_rad);
    const StereoTags seen = rim.See(out.truth.back(), kNoise_px, random);
    out.rim.push_back(f % 3 == 2 ? RimAngle() : finder.Find(seen, out.surface.back()));
  }
  return out;
}

TEST(HoldToRim, TakesTheTwistOfTheCarcassOut) {
  const TaggedWheel rim = Rim();
  std::mt19937 random(6);
  constexpr double kTwist = 0.45 * kDegrees, kSurface = 2e-6;
  Consistency twist;
  for (int draw = 0; draw < 120; ++draw) {
    const Recording recording = Record(
        rim, [](int) { return kTwist; }, kSurface, 12, random);
    const AnglesOfRim held = HoldToRim(recording.surface, recording.sigma, {}, recording.rim);
    ASSERT_TRUE(held.twist.known && held.twist.steady);
    EXPECT_EQ(held.twist.frames, 8);
    EXPECT_EQ(held.sigma_common_rad, held.twist.sigma_random_rad);
    twist.Add(held.twist.angle_rad - kTwist, held.twist.sigma_random_rad);
    for (std::size_t f = 0; f < 12; ++f) {
      // To each other they are as sure as the surface.
      EXPECT_NEAR(held.angles_rad[f] - held.angles_rad[0],
                  recording.surface[f] - recording.surface[0], 1e-12);
      EXPECT_EQ(held.sigmas_rad[f], kSurface);
      EXPECT_NEAR(held.angles_rad[f], recording.truth[f], 6 * held.sigma_common_rad);
    }
  }
  twist.Print("twist of the carcass, rad");
  // It is never told surer than noise lets it be, so that it is below 1.
  EXPECT_GT(twist.nees(), 0.6);
  EXPECT_LT(twist.nees(), 1 + 4 * std::sqrt(2.0 / 120));
}

TEST(HoldToRim, IsOfTheTagsWhereTheTwistChanges) {
  const TaggedWheel rim = Rim();
  std::mt19937 random(7);
  const auto drawn = [](int f) { return (f < 10 ? 0 : 0.06 * (f - 10)) * kDegrees; };
  const Recording recording = Record(rim, drawn, 2e-6, 30, random);
  const AnglesOfRim held = HoldToRim(recording.surface, recording.sigma, {}, recording.rim);
  EXPECT_FALSE(held.twist.steady);
  Consistency by_tags;
  for (std::size_t f = 0; f < 30; ++f) {
    const double off = held.angles_rad[f] - recording.truth[f];
    if (recording.rim[f].found) {
      by_tags.Add(off, held.sigmas_rad[f]);
    } else {
      EXPECT_LT(std::abs(off), 3 * held.sigmas_rad[f]) << f;
      EXPECT_GT(held.sigmas_rad[f], 0.1 * kDegrees);
    }
  }
  EXPECT_NEAR(by_tags.nees(), 1, 4 * std::sqrt(2.0 / 20));
}

TEST(HoldToRim, GoesThroughTheModes) {
  Recording recording;
  RimAngle none, some;
  some.found = true;
  some.angle_rad = 1;
  some.sigma_per_px_rad = 1e-3;
  some.squares_px2 = 0.15;
  some.freedoms = 15;
  some.along_modes_rad = Eigen::Vector2d(1e-5, -2e-5);
  const std::vector<RimAngle> rim = {some, none};
  const std::vector<double> surface = {1.01, 2.01}, sigma = {1e-5, 1e-5};
  Eigen::MatrixXd along(2, 2);
  along << 3e-5, 4e-5, 0, 1e-5;
  const AnglesOfRim held = HoldToRim(surface, sigma, along, rim);
  // The angle in the frame of the tag is the tag's.
  EXPECT_LT((held.along_modes_rad.col(0) - some.along_modes_rad).norm(), 1e-18);
  EXPECT_LT((held.along_modes_rad.col(1) - Eigen::Vector2d(2e-5, -1e-5)).norm(), 1e-18);
  EXPECT_NEAR(held.twist.angle_rad, 0.01, 1e-12);
  EXPECT_NEAR(held.twist.sigma_calibration_rad, std::hypot(2e-5, 2e-5), 1e-15);
  EXPECT_NEAR(held.twist.corner_sigma_px, 0.1, 1e-12);
}

TEST(HoldToRim, LeavesAnglesAsTheyAreWithoutTags) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<double> surface = {1, nan}, sigma = {1e-5, nan};
  const std::vector<RimAngle> rim(2);
  const AnglesOfRim held = HoldToRim(surface, sigma, {}, rim);
  EXPECT_FALSE(held.twist.known);
  EXPECT_EQ(held.angles_rad[0], 1);
  EXPECT_TRUE(std::isnan(held.angles_rad[1]));
  EXPECT_THROW((void)HoldToRim(surface, sigma, Eigen::MatrixXd::Zero(1, 3), rim),
               std::invalid_argument);
  EXPECT_THROW((void)HoldToRim(surface, {sigma.data(), 1}, {}, rim), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
