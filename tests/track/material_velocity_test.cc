#include "track/material_velocity.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>

#include "calib/error.h"
#include "match/planar_field.h"
#include "tests/support/rolling_wheel.h"

namespace plumbline {
namespace {

using testing::RollingWheel;

Scenario At(const char* name, double frames_per_second = 50) {
  Scenario scenario = MakeScenario(name);
  scenario.frames_per_second = frames_per_second;
  scenario.frames = 30;
  return scenario;
}

// Of what the material moves by against the wheel's centre.
Eigen::Vector3d ErrorAt(const MaterialVelocity& velocity, const RollingWheel::True& now,
                        double speed_mm_s, std::size_t i) {
  return velocity.value_mm_s.data()[i] + Eigen::Vector3d(speed_mm_s, 0, 0) -
         now.velocity_mm_s.data()[i];
}

struct Rms {
  double squares = 0;
  int count = 0;
  void Add(double squared) {
    squares += squared;
    ++count;
  }
  double value() const { return std::sqrt(squares / count); }
};

TEST(MaterialVelocity, StandsStillOnTheGroundWhereItSticks) {
  const RollingWheel wheel(At("tyre-flat"));
  const auto before = wheel.Truth(4), now = wheel.Truth(5), after = wheel.Truth(6);
  const MaterialVelocity velocity =
      VelocityOfMaterial({&before.frame, &now.frame, &after.frame}, wheel.neighbours());
  Rms middle, ahead;
  for (std::size_t i = 0; i < velocity.value_mm_s.pixel_count(); ++i) {
    if (velocity.from.data()[i] != VelocityFrom::kBoth) continue;
    const Eigen::Vector3d error = ErrorAt(velocity, now, 1400, i);
    const Eigen::Vector3d& at = now.ground_mm.data()[i];
    if (now.frame.contact.data()[i] != 0 && std::abs(at.x()) < 40) {
      EXPECT_LT(error.head<2>().norm(), 4) << at.transpose();  // the belt straightens behind -40
      middle.Add(error.head<2>().squaredNorm());
    } else if (at.z() > 24 && std::abs(at.y()) < 60) {
      ahead.Add(error.squaredNorm());
    }
  }
  ASSERT_GT(middle.count, 200);
  EXPECT_LT(middle.value(), 0.3);
  // Beside the patch the path bends within the 28 mm between frames.
  EXPECT_GT(ahead.value(), 10);
  EXPECT_LT(ahead.value(), 150);
}

// Over the same material moments, frames half as far apart.
TEST(MaterialVelocity, IsOfSecondOrderInTimeFromBothNeighbours) {
  double both[2], one[2];
  for (const int k : {0, 1}) {
    const RollingWheel wheel(At("tyre-flat", k == 0 ? 100 : 200), 8);
    const int f = k == 0 ? 10 : 20;
    const auto before = wheel.Truth(f - 1), now = wheel.Truth(f), after = wheel.Truth(f + 1);
    const FrameTriple three{&before.frame, &now.frame, &after.frame};
    const MaterialVelocity central = VelocityOfMaterial(three, wheel.neighbours());
    const MaterialVelocity since =
        VelocityOfMaterial({&before.frame, &now.frame, nullptr}, wheel.neighbours());
    Rms rms_both, rms_one;
    for (std::size_t i = 0; i < central.value_mm_s.pixel_count(); ++i) {
      const Eigen::Vector3d& at = now.ground_mm.data()[i];
      if (central.from.data()[i] != VelocityFrom::kBoth || std::abs(at.y()) > 60 || at.z() < 22) {
        continue;
      }
      rms_both.Add(ErrorAt(central, now, 1400, i).squaredNorm());
      rms_one.Add(ErrorAt(since, now, 1400, i).squaredNorm());
    }
    ASSERT_GT(rms_both.count, 50);
    both[k] = rms_both.value();
    one[k] = rms_one.value();
  }
  EXPECT_GT(both[0] / both[1], 2.7);
  EXPECT_NEAR(one[0] / one[1], 2, 0.5);
}

// Beside a bar along the way the belt bends across the tyre, alike in all frames.
TEST(MaterialVelocity, TakesNoBendForAMotionFromOneNeighbour) {
  const RollingWheel wheel(At("cleat-offset-angle40"));
  const auto now = wheel.Truth(5), after = wheel.Truth(6);
  const MaterialVelocity velocity =
      VelocityOfMaterial({nullptr, &now.frame, &after.frame}, wheel.neighbours());
  double sideways = 0;
  int count = 0;
  for (std::size_t i = 0; i < velocity.value_mm_s.pixel_count(); ++i) {
    if (velocity.from.data()[i] == VelocityFrom::kNone || now.frame.contact.data()[i] == 0 ||
        std::abs(now.ground_mm.data()[i].x()) > 50) {
      continue;
    }
    sideways += ErrorAt(velocity, now, 1400, i).y();
    ++count;
  }
  ASSERT_GT(count, 50);
  EXPECT_LT(std::abs(sideways / count), 0.1);
}

TEST(MaterialVelocity, LeavesTheRigsOwnTurnOut) {
  Scenario scenario = At("tyre-flat");
  std::get<TyreOptions>(scenario.surface).speed_swing_mm_s = 300;
  scenario.motion.flexure_rad_per_m_s2 = 0.02;
  const RollingWheel wheel(scenario);
  // A frame is missing before this one, so that both intervals differ.
  auto before = wheel.Truth(10), now = wheel.Truth(12), after = wheel.Truth(13);
  const auto worst = [&] {
    const MaterialVelocity velocity =
        VelocityOfMaterial({&before.frame, &now.frame, &after.frame}, wheel.neighbours());
    double most = 0;
    int count = 0;
    for (std::size_t i = 0; i < velocity.value_mm_s.pixel_count(); ++i) {
      if (velocity.from.data()[i] != VelocityFrom::kBoth || now.frame.contact.data()[i] == 0 ||
          std::abs(now.ground_mm.data()[i].x() + 10) > 15) {
        continue;
      }
      const Eigen::Vector3d error = ErrorAt(velocity, now, wheel.Wheel(12).speed_mm_s, i);
      most = std::max(most, error.head<2>().norm());
      ++count;
    }
    EXPECT_GT(count, 60);
    return most;
  };
  // The speed's own third derivative: 300 (2 pi)^2 mm/s^3 * 0.04 s * 0.02 s / 6 at most.
  EXPECT_LT(worst(), 3);
  before.frame.ground = after.frame.ground = now.frame.ground;
  EXPECT_GT(worst(), 10);
}

TEST(MaterialVelocity, IsNotKnownWhereItsMaterialWasNotSeen) {
  const RollingWheel wheel(At("tyre-flat"));
  auto before = wheel.Truth(4), now = wheel.Truth(5);
  // A hole where material was.
  const std::size_t middle = static_cast<std::size_t>(15 * now.ground_mm.width() + 20);
  const Eigen::Vector3d lost = now.frame.material.data()[middle];
  for (std::size_t i = 0; i < before.frame.material.pixel_count(); ++i) {
    const Eigen::Vector3d& m = before.frame.material.data()[i];
    if (std::hypot(384 * (m.x() - lost.x()), m.y() - lost.y()) < 30) {
      before.frame.points.point_mm.data()[i].setConstant(NAN);
    }
  }
  const MaterialVelocity velocity =
      VelocityOfMaterial({&before.frame, &now.frame, nullptr}, wheel.neighbours());
  EXPECT_EQ(velocity.from.data()[middle], VelocityFrom::kNone);
  EXPECT_TRUE(velocity.value_mm_s.data()[middle].array().isNaN().all());
  EXPECT_TRUE(std::isnan(velocity.cov_random_mm2_s2.data()[middle][0]));
  int known = 0;
  for (const VelocityFrom from : velocity.from.values()) {
    EXPECT_NE(from, VelocityFrom::kAfter);
    EXPECT_NE(from, VelocityFrom::kBoth);
    known += from == VelocityFrom::kBefore ? 1 : 0;
  }
  EXPECT_GT(known, 500);
}

TEST(MaterialVelocity, RefusesWhatDoesNotFit) {
  const RollingWheel wheel(At("tyre-flat"), 40);
  const auto now = wheel.Truth(5), after = wheel.Truth(6);
  const NeighbourCorrelation& neighbours = wheel.neighbours();
  EXPECT_THROW((void)VelocityOfMaterial({&after.frame, &now.frame, nullptr}, neighbours),
               InputError);
  EXPECT_THROW((void)VelocityOfMaterial({nullptr, &now.frame, nullptr}, neighbours),
               std::invalid_argument);
  EXPECT_THROW(
      (void)VelocityOfMaterial({nullptr, &now.frame, &after.frame}, neighbours, {.reach_mm = -1}),
      UsageError);
  FrameTriple uneven{nullptr, &now.frame, &after.frame};
  uneven.ground_errors[1].setZero(6, 2);
  EXPECT_THROW((void)VelocityOfMaterial(uneven, neighbours), std::invalid_argument);
  auto other = after;
  other.frame.points.along_modes_mm.emplace_back(after.frame.points.size(),
                                                 Eigen::Vector3f::Zero());
  EXPECT_THROW((void)VelocityOfMaterial({nullptr, &now.frame, &other.frame}, neighbours),
               std::invalid_argument);
}

class NoisyVelocity : public ::testing::Test {
 protected:
  static constexpr double kDepth_mm = 0.08, kAcross_mm = 0.02, kTurn_rad = 2e-4, kShift_mm = 0.01;
  static constexpr double kGroundCorrelation = 0.6;

  NoisyVelocity() : wheel_(At("tyre-flat"), 24, 3) {
    for (int k = 0; k < 3; ++k) {
      frames_.push_back(wheel_.Truth(4 + k).frame);
      wheel_.SetNoise(frames_.back(), kDepth_mm, kAcross_mm);
      testing::SetModes(frames_.back().points);
      frames_.back().ground.cov_random.diagonal()
          << Eigen::Vector3d::Constant(kTurn_rad * kTurn_rad),
          Eigen::Vector3d::Constant(kShift_mm * kShift_mm);
    }
  }

  // Each frame has of the ground's errors what the one before has, by so much, and errors of its
  // own.
  FrameTriple Triple(const std::vector<MaterialFrame>& frames) const {
    FrameTriple triple{&frames[0], &frames[1], &frames[2]};
    const Eigen::Matrix<double, 6, 6> root = frames[1].ground.Root();
    for (auto& errors : triple.ground_errors) errors.setZero(6, 18);
    triple.ground_errors[0].leftCols<6>() = root;
    for (std::size_t f = 1; f < 3; ++f) {
      triple.ground_errors[f] = kGroundCorrelation * triple.ground_errors[f - 1];
      triple.ground_errors[f].middleCols<6>(6 * static_cast<Eigen::Index>(f)) =
          std::sqrt(1 - kGroundCorrelation * kGroundCorrelation) * root;
    }
    return triple;
  }
  MaterialVelocity Of(const std::vector<MaterialFrame>& frames) const {
    return VelocityOfMaterial(Triple(frames), wheel_.neighbours());
  }

  RollingWheel wheel_;
  std::vector<MaterialFrame> frames_;
};

TEST_F(NoisyVelocity, CovarianceIsThatOfSampling) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const auto six = [&] {
    Eigen::Matrix<double, 6, 1> numbers = Eigen::Matrix<double, 6, 1>::Zero();
    for (double& n : numbers) n = normal(random);
    return numbers;
  };
  // Each frame with two errors of its own that its points have in common.
  for (MaterialFrame& frame : frames_) {
    const Image<Eigen::Vector3d>& points = frame.points.point_mm;
    frame.along_own_mm.assign(2, Image<Eigen::Vector3f>(points.size(), Eigen::Vector3f::Zero()));
    for (std::size_t i = 0; i < points.pixel_count(); ++i) {
      const Eigen::Vector3d& p = points.data()[i];
      frame.along_own_mm[0].data()[i] = (kTurn_rad * p).cast<float>();
      frame.along_own_mm[1].data()[i] =
          (kTurn_rad * Eigen::Vector3d(p.y(), 0, p.x())).cast<float>();
    }
  }
  const MaterialVelocity exact = Of(frames_);
  // Points of all kinds, far from each other.
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < exact.from.pixel_count(); i += 29) {
    if (exact.from.data()[i] != VelocityFrom::kNone) places.push_back(i);
  }
  ASSERT_GT(places.size(), 8U);
  Image<double> weight(exact.size(), 0.0);
  for (const std::size_t i : places) weight.data()[i] = 1.0 / static_cast<double>(places.size());
  const MeanVelocity mean = MeanOf(exact, Triple(frames_), weight, wheel_.neighbours());
  const Eigen::Matrix3d mean_cov =
      mean.cov_independent + mean.along_common * mean.along_common.transpose();
  constexpr int kDraws = 200;
  double nees = 0, nees_mean = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<MaterialFrame> noisy = frames_;
    Eigen::Matrix<double, 6, 1> ground = six();
    for (std::size_t f = 0; f < 3; ++f) {
      wheel_.AddNoise(noisy[f].points, kDepth_mm, kAcross_mm, random);
      for (const Image<Eigen::Vector3f>& own : noisy[f].along_own_mm) {
        const double size = normal(random);
        for (std::size_t i = 0; i < own.pixel_count(); ++i) {
          noisy[f].points.point_mm.data()[i] += size * own.data()[i].cast<double>();
        }
      }
      if (f > 0) {
        ground = kGroundCorrelation * ground +
                 std::sqrt(1 - kGroundCorrelation * kGroundCorrelation) * six();
      }
      Rigid3& frame = noisy[f].ground.frame_from_rig;
      frame =
          Rigid3::FromRotationVector(kTurn_rad * ground.head<3>(), kShift_mm * ground.tail<3>()) *
          frame;
    }
    const MaterialVelocity velocity = Of(noisy);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const std::size_t i : places) {
      const Eigen::Vector3d error = velocity.value_mm_s.data()[i] - exact.value_mm_s.data()[i];
      sum += error / static_cast<double>(places.size());
      Eigen::Matrix3d cov = CovarianceOf(velocity.cov_random_mm2_s2.data()[i]);
      for (const auto& along : velocity.along_common_mm_s) {
        const Eigen::Vector3d e = along.data()[i].cast<double>();
        cov += e * e.transpose();
      }
      nees += error.dot(cov.ldlt().solve(error)) / kDraws / static_cast<double>(places.size());
    }
    nees_mean += sum.dot(mean_cov.ldlt().solve(sum)) / kDraws;
  }
  EXPECT_NEAR(nees, 3, 0.3);
  EXPECT_NEAR(nees_mean, 3, 4 * std::sqrt(6.0 / kDraws));
}

TEST_F(NoisyVelocity, MovesAlongTheModesAsItSays) {
  frames_[1].ground.along_modes.assign(testing::kFieldModes, frames_[1].ground.frame_from_rig);
  for (std::size_t f = 0; f < 3; ++f) {
    const Rigid3 frame = frames_[f].ground.frame_from_rig;
    frames_[f].ground.along_modes = {
        frame, Rigid3::FromRotationVector({3e-4, -2e-4, 0}, {0, 0, 0.05}) * frame, frame};
  }
  const MaterialVelocity exact = Of(frames_);
  EXPECT_LT((exact.turn_along_modes_rad[1] - Eigen::Vector3d(3e-4, -2e-4, 0)).norm(), 1e-9);
  for (std::size_t k = 0; k < testing::kFieldModes; ++k) {
    std::vector<MaterialFrame> moved = frames_;
    for (MaterialFrame& frame : moved) {
      testing::MoveAlongModes(frame.points, Eigen::Vector3d::Unit(static_cast<int>(k)));
      frame.ground.frame_from_rig = frame.ground.along_modes[k];
    }
    const MaterialVelocity velocity = Of(moved);
    for (std::size_t i = 0; i < exact.from.pixel_count(); ++i) {
      if (exact.from.data()[i] == VelocityFrom::kNone) continue;
      const Eigen::Vector3d change = velocity.value_mm_s.data()[i] - exact.value_mm_s.data()[i];
      EXPECT_LT((change - exact.along_modes_mm_s[k].data()[i].cast<double>()).norm(), 2e-3)
          << k << ' ' << change.transpose();
    }
  }
}

}  // namespace
}  // namespace plumbline
