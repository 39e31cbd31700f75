#include "track/rolling_slip.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <random>
#include <span>
#include <string>
#include <vector>

#include "calib/error.h"
#include "tests/support/rolling_wheel.h"
#include "track/rig_rotation.h"

namespace plumbline {
namespace {

using testing::RollingWheel;
constexpr double kDegree = std::numbers::pi / 180;
constexpr int kFrame = 5;

// Three frames in a row with their errors, and what is known of the wheel.
struct Measured {
  MaterialFrame before, now, after;
  WheelTurning wheel;

  std::array<Eigen::Matrix<double, 6, Eigen::Dynamic>, 3> ground_errors;

  FrameTriple frames() const { return {&before, &now, &after, ground_errors}; }
};

struct Sigmas {
  double depth_mm = 0, across_mm = 0;
  double axis_rad = 0, omega = 0;  // relative
  double ground_rad = 0, ground_mm = 0;
  // Or of the poses of the rig, and what two frames in a row have in common of them.
  RigPose pose = RigPose::Zero();
  double poses_alike = 0;
  bool calibration = false;
};

class Scene {
 public:
  Scene(const char* name, int overlap, const Sigmas& sigmas, int step_px = 16)
      : wheel_(MakeScenario(name), step_px, overlap), sigmas_(sigmas) {
    for (int k = 0; k < 3; ++k) {
      truth_.push_back(wheel_.Truth(kFrame - 1 + k));
      MaterialFrame& frame = truth_.back().frame;
      wheel_.SetNoise(frame, sigmas.depth_mm, sigmas.across_mm);
      if (sigmas.calibration) testing::SetModes(frame.points);
      frame.ground.cov_random.diagonal()
          << Eigen::Vector3d::Constant(std::pow(sigmas.ground_rad, 2)),
          Eigen::Vector3d::Constant(std::pow(sigmas.ground_mm, 2));
    }
  }

  const RollingWheel& wheel() const { return wheel_; }
  const RollingWheel::True& now() const { return truth_[1]; }
  const TyreOptions& tyre() const { return wheel_.tyre().options(); }
  double speed() const { return wheel_.Wheel(kFrame).speed_mm_s; }

  WheelAxis AxisAlongModes(const Eigen::Vector3d& amount) const {
    return testing::AxisAlongModes(wheel_.Axis(kFrame), amount);
  }

  Measured Exact() const { return Draw(nullptr); }

  Measured Draw(std::mt19937* random) const {
    std::normal_distribution<double> normal;
    const auto three = [&](double sigma) {
      if (random == nullptr || sigma == 0) return Eigen::Vector3d(0, 0, 0);
      const double a = normal(*random), b = normal(*random), c = normal(*random);
      return Eigen::Vector3d(sigma * a, sigma * b, sigma * c);
    };
    Measured m;
    const Eigen::Vector3d amount = three(sigmas_.calibration ? 1 : 0);
    MaterialFrame* const frames[] = {&m.before, &m.now, &m.after};
    for (std::size_t k = 0; k < 3; ++k) {
      *frames[k] = truth_[k].frame;
      if (random == nullptr) continue;
      if (sigmas_.calibration) testing::MoveAlongModes(frames[k]->points, amount);
      wheel_.AddNoise(frames[k]->points, sigmas_.depth_mm, sigmas_.across_mm, *random);
      const Eigen::Vector3d turn = three(sigmas_.ground_rad), shift = three(sigmas_.ground_mm);
      Rigid3& frame = frames[k]->ground.frame_from_rig;
      frame = Rigid3::FromRotationVector(turn, shift) * frame;
    }
    m.wheel.axis = AxisAlongModes(amount);
    m.wheel.axis.rotation = m.wheel.axis.rotation * RotationFromVector(three(sigmas_.axis_rad));
    m.wheel.cov_axis_random.diagonal().head<3>().setConstant(std::pow(sigmas_.axis_rad, 2));
    if (sigmas_.calibration) m.wheel.axis_along_modes = testing::ModesOfAxis(wheel_.Axis(kFrame));
    const double omega = wheel_.Wheel(kFrame).angular_speed_rad_s;
    m.wheel.speed_rad_s.value = omega * (1 + three(sigmas_.omega).x());
    m.wheel.speed_rad_s.sigma_random = omega * sigmas_.omega;
    if (!sigmas_.pose.isZero()) TurnGrounds(random, m);
    return m;
  }

  RollingSlip Slip(const Measured& m, const RollingSlipOptions& options = {},
                   bool with_radius = true) const {
    std::optional<MeasuredScalar> radius;
    if (with_radius) radius = MeasuredScalar{tyre().free_rolling_radius_mm, 0, {}};
    const MaterialVelocity velocity = VelocityOfMaterial(m.frames(), wheel_.neighbours());
    return MeasureSlip(velocity, m.frames(), m.wheel, m.now.contact, wheel_.neighbours(), radius,
                       std::nullopt, options);
  }

 private:
  // Errors of the poses turn the grounds and are in the speed at which the wheel turns over them.
  void TurnGrounds(std::mt19937* random, Measured& m) const {
    std::normal_distribution<double> normal;
    Eigen::Matrix3d alike;
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) alike(a, b) = std::pow(sigmas_.poses_alike, std::abs(a - b));
    }
    const Eigen::Matrix3d mixing = Eigen::LLT<Eigen::Matrix3d>(alike).matrixL();
    Eigen::Matrix<double, 9, 9> root = Eigen::Matrix<double, 9, 9>::Zero();
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) {
        root.block<3, 3>(3 * a, 3 * b) = mixing(a, b) * Eigen::Matrix3d(sigmas_.pose.asDiagonal());
      }
    }
    Eigen::Matrix<double, 9, 1> draw = Eigen::Matrix<double, 9, 1>::Zero();
    for (double& value : draw) value = random != nullptr ? normal(*random) : 0;
    const Eigen::Matrix<double, 9, 1> error = root * draw;
    MaterialFrame* const frames[] = {&m.before, &m.now, &m.after};
    for (std::size_t k = 0; k < 3; ++k) {
      const auto at = 3 * static_cast<Eigen::Index>(k);
      const WheelAxis axis = wheel_.Axis(kFrame - 1 + static_cast<int>(k));
      GroundPlane plane;
      const Rigid3& ground = truth_[k].frame.ground.frame_from_rig;
      plane.normal = ground.rotation.row(2);
      plane.offset_mm = -ground.translation_mm.z();
      const RigPose pose = PoseOf(plane, axis);
      m.ground_errors[k] = GroundJacobian(pose, axis) * root.middleRows<3>(at);
      const Rigid3 moved =
          GroundOf(pose + error.segment<3>(at), axis) * GroundOf(pose, axis).Inverse();
      frames[k]->ground.frame_from_rig = moved * frames[k]->ground.frame_from_rig;
    }
    const double time_s = m.after.time_s - m.before.time_s;
    m.wheel.speed_rad_s.value -= (error[6] - error[0]) / time_s;
    m.wheel.speed_along_common_rad_s = (root.row(0) - root.row(6)) / time_s;
  }

  RollingWheel wheel_;
  Sigmas sigmas_;
  std::vector<RollingWheel::True> truth_;
};

// Kept from test to test: to make one takes longer than most tests.
const Scene& Known(const std::string& name) {
  static std::map<std::string, Scene> scenes;
  const Sigmas sigmas{.depth_mm = 0.08, .across_mm = 0.02, .calibration = true};
  return scenes.try_emplace(name, name.c_str(), 1, sigmas, 24).first->second;
}

TEST(RollingSlip, IsThatOfTheTyre) {
  for (const char* name :
       {"tyre-flat", "tyre-braking", "tyre-cornering", "cleat-lateral-square38"}) {
    const Scene& scene = Known(name);
    const RollingSlip slip = scene.Slip(scene.Exact());
    ASSERT_TRUE(slip.found) << name << slip.problem;
    EXPECT_TRUE(slip.problem.empty());
    const TyreOptions& tyre = scene.tyre();
    EXPECT_NEAR(slip.speed_mm_s.value, 1400, 0.3) << name;
    EXPECT_NEAR(slip.ratio.value, tyre.slip_ratio, 0.0002) << name;
    EXPECT_NEAR(slip.slip_angle_rad.value, tyre.slip_angle_rad, 0.01 * kDegree) << name;
    EXPECT_NEAR(slip.effective_radius_mm.value, 389 / (1 + tyre.slip_ratio), 0.1) << name;
    EXPECT_LT((slip.velocity_mm_s - Eigen::Vector3d(1400, 0, 0)).head<2>().norm(), 0.4) << name;
  }
}

TEST(RollingSlip, FindsTheSlidingZone) {
  for (const char* name : {"tyre-braking", "tyre-cornering"}) {
    const Sigmas sigmas{.depth_mm = 0.08, .across_mm = 0.02};
    const Scene scene(name, 3, sigmas);
    std::mt19937 random(5);
    const RollingSlip slip = scene.Slip(scene.Draw(&random));
    ASSERT_TRUE(slip.found);
    const double threshold = 0.02 * scene.speed();
    int missed = 0, slides = 0, wrong = 0, sticks = 0;
    double true_points = 0, found_points = 0;
    for (std::size_t i = 0; i < slip.motion.pixel_count(); ++i) {
      if (slip.motion.data()[i] == ContactMotion::kNoContact) continue;
      const double speed = scene.now().velocity_mm_s.data()[i].head<2>().norm();
      if (scene.now().ground_mm.data()[i].x() > 60) continue;  // where shear sets in
      true_points += speed > threshold ? 1 : 0;
      found_points += slip.motion.data()[i] == ContactMotion::kSliding ? 1 : 0;
      // Half of the way between frames smears the zone's edge.
      if (speed > 4 * threshold) {
        ++slides;
        missed += slip.motion.data()[i] == ContactMotion::kSticking ? 1 : 0;
      } else if (speed < 0.001) {
        ++sticks;
        wrong += slip.motion.data()[i] == ContactMotion::kSliding ? 1 : 0;
      }
    }
    EXPECT_EQ(missed, 0) << name << " of " << slides;
    EXPECT_GT(sticks, 250) << name;
    EXPECT_LE(wrong, 0.05 * sticks) << name;
    EXPECT_GT(slides, 25) << name;
    EXPECT_NEAR(found_points / true_points, 1, 0.15) << name;
  }
  const Scene& flat = Known("tyre-flat");
  std::mt19937 random(6);
  EXPECT_EQ(flat.Slip(flat.Draw(&random)).sliding, 0);
}

TEST(RollingSlip, SigmasAreThoseOfSampling) {
  const Sigmas sigmas{.depth_mm = 0.08,
                      .across_mm = 0.02,
                      .axis_rad = 2e-4,
                      .omega = 3e-4,
                      .ground_rad = 1e-4,
                      .ground_mm = 0.01,
                      .calibration = true};
  for (const char* name : {"tyre-braking", "tyre-cornering"}) {
    const Scene scene(name, 3, sigmas, 24);
    std::mt19937 random(7);
    constexpr int kDraws = 160;
    double squares[3] = {};
    int covered[3] = {};
    for (int draw = 0; draw < kDraws; ++draw) {
      const RollingSlip slip = scene.Slip(scene.Draw(&random));
      ASSERT_TRUE(slip.found);
      const MeasuredScalar* const results[] = {&slip.speed_mm_s, &slip.ratio, &slip.slip_angle_rad};
      const double truths[] = {scene.speed(), scene.tyre().slip_ratio, scene.tyre().slip_angle_rad};
      for (int k = 0; k < 3; ++k) {
        const double sigma = std::hypot(results[k]->sigma_random, results[k]->sigma_calibration());
        const double error = results[k]->value - truths[k];
        squares[k] += std::pow(error / sigma, 2) / kDraws;
        covered[k] += std::abs(error) < 1.96 * sigma ? 1 : 0;
      }
      EXPECT_LT(std::abs(slip.ratio.value - scene.tyre().slip_ratio), 0.002);
    }
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(squares[k], 1, 4 * std::sqrt(2.0 / kDraws)) << name << ' ' << k;
      EXPECT_NEAR(covered[k] / static_cast<double>(kDraws), 0.95, 0.04) << name << ' ' << k;
    }
  }
}

// Errors of the ground's pose that frames in a row have in common drop out of speed and angle, and
// what is left of them in the speed is nearly all in the wheel's turning over the ground too.
TEST(RollingSlip, CountsWhatFramesHaveInCommonOfTheGround) {
  double sigmas_speed[2], sigmas_radius[2];
  for (const int k : {0, 1}) {
    const Scene scene("tyre-braking", 3,
                      {.depth_mm = 0.01,
                       .across_mm = 0.003,
                       .omega = 1e-6,
                       .pose = RigPose(1e-5, 1e-5, 1e-3),
                       .poses_alike = k == 0 ? 0.5 : 0.995},
                      24);
    const RollingSlip exact = scene.Slip(scene.Exact());
    std::mt19937 random(11);
    constexpr int kDraws = 100;
    double squares[3] = {};
    for (int draw = 0; draw < kDraws; ++draw) {
      const RollingSlip slip = scene.Slip(scene.Draw(&random));
      ASSERT_TRUE(slip.found);
      const auto add = [&](const MeasuredScalar RollingSlip::*of, int at) {
        const double error = (slip.*of).value - (exact.*of).value;
        squares[at] += std::pow(error / (slip.*of).sigma_random, 2) / kDraws;
      };
      add(&RollingSlip::speed_mm_s, 0);
      add(&RollingSlip::effective_radius_mm, 1);
      add(&RollingSlip::slip_angle_rad, 2);
      sigmas_speed[k] = slip.speed_mm_s.sigma_random;
      sigmas_radius[k] = slip.effective_radius_mm.sigma_random;
    }
    for (const double square : squares) {
      EXPECT_NEAR(square, 1, 4 * std::sqrt(2.0 / kDraws)) << k;
    }
  }
  EXPECT_LT(sigmas_speed[1], 0.4 * sigmas_speed[0]);
  // The speed's error from the ground alone is 0.11 mm/s, that of the turning 3e-4 rad/s: each
  // would be 0.03 mm of the radius.
  EXPECT_LT(sigmas_radius[0], 0.02);
}

TEST(RollingSlip, MovesAlongTheModesAsItSays) {
  const Scene& scene = Known("tyre-cornering");
  const Measured exact = scene.Exact();
  const RollingSlip slip = scene.Slip(exact);
  for (Eigen::Index k = 0; k < static_cast<Eigen::Index>(testing::kFieldModes); ++k) {
    Measured moved = exact;
    for (MaterialFrame* frame : {&moved.before, &moved.now, &moved.after}) {
      testing::MoveAlongModes(frame->points, Eigen::Vector3d::Unit(k));
    }
    moved.wheel.axis = scene.AxisAlongModes(Eigen::Vector3d::Unit(k));
    const RollingSlip along = scene.Slip(moved);
    const auto check = [&](const MeasuredScalar RollingSlip::*of, double tolerance) {
      EXPECT_NEAR((along.*of).value - (slip.*of).value, (slip.*of).along_modes[k], tolerance) << k;
    };
    check(&RollingSlip::speed_mm_s, 0.01);
    check(&RollingSlip::ratio, 1e-5);
    check(&RollingSlip::slip_angle_rad, 1e-5);
    check(&RollingSlip::effective_radius_mm, 0.003);
  }
}

TEST(RollingSlip, TellsTheAngleInTheSenseOfSae) {
  const Scene& scene = Known("tyre-cornering");
  const Measured exact = scene.Exact();
  const RollingSlip iso = scene.Slip(exact);
  const RollingSlip sae = scene.Slip(exact, {.convention = SlipConvention::kSaeJ670});
  EXPECT_GT(iso.slip_angle_rad.value, 0.05);
  EXPECT_EQ(sae.slip_angle_rad.value, -iso.slip_angle_rad.value);
  EXPECT_EQ(sae.ratio.value, iso.ratio.value);
  EXPECT_EQ(sae.convention, SlipConvention::kSaeJ670);
}

TEST(RollingSlip, SaysWhatIsMissingWithoutAFreeRadius) {
  const Scene& scene = Known("tyre-braking");
  const RollingSlip slip = scene.Slip(scene.Exact(), {}, false);
  EXPECT_TRUE(slip.found);
  EXPECT_TRUE(slip.effective_radius_mm.known());
  EXPECT_GT(slip.sliding, 0);
  EXPECT_FALSE(slip.ratio.known());
  EXPECT_NE(slip.problem.find("radius of free rolling"), std::string::npos);
}

TEST(RollingSlip, IsNotGuessedWhereThePatchIsOutOfView) {
  const Scene& scene = Known("tyre-flat");
  Measured hidden = scene.Exact();
  for (int r = 0; r < hidden.now.contact.height(); ++r) {
    for (int c = 8; c < hidden.now.contact.width(); ++c) hidden.now.contact(r, c) = 0;
  }
  const RollingSlip slip = scene.Slip(hidden);
  EXPECT_FALSE(slip.found);
  EXPECT_FALSE(slip.speed_mm_s.known());
  EXPECT_NE(slip.problem.find("out of view"), std::string::npos);
  Measured backwards = scene.Exact();
  backwards.wheel.speed_rad_s.value *= -1;
  EXPECT_NE(scene.Slip(backwards).problem.find("does not roll forwards"), std::string::npos);
  EXPECT_THROW((void)scene.Slip(scene.Exact(), {.sliding_share = 0}), UsageError);
}

TEST(RollingSlip, CountsFromARunThatRollsFreely) {
  const Scene &free = Known("tyre-flat"), &braking = Known("tyre-braking");
  std::mt19937 random(9);
  std::vector<RollingSlip> run;
  for (int k = 0; k < 8; ++k) run.push_back(free.Slip(free.Exact()));
  for (RollingSlip& slip : run) {
    std::normal_distribution<double> normal;
    slip.effective_radius_mm.value += slip.effective_radius_mm.sigma_random * normal(random);
  }
  const auto radius = FreeRollingRadius(run);
  ASSERT_TRUE(radius.has_value());
  EXPECT_NEAR(radius->value, 389, 4 * radius->sigma_random);
  EXPECT_LT(radius->sigma_random, 0.6 * run[0].effective_radius_mm.sigma_random);
  EXPECT_GT(radius->sigma_calibration(), 0.02);
  EXPECT_FALSE(FreeRollingRadius(std::span(run).first(1)).has_value());
  // An error of scale is in both radii.
  const Measured m = braking.Exact();
  const MaterialVelocity velocity = VelocityOfMaterial(m.frames(), braking.wheel().neighbours());
  const auto slip_with = [&](const MeasuredScalar& with) {
    return MeasureSlip(velocity, m.frames(), m.wheel, m.now.contact, braking.wheel().neighbours(),
                       with, std::nullopt);
  };
  MeasuredScalar foreign = *radius;
  foreign.along_modes = Eigen::VectorXd::Constant(1, radius->sigma_calibration());
  EXPECT_LT(slip_with(*radius).ratio.sigma_calibration(),
            0.2 * slip_with(foreign).ratio.sigma_calibration());
}

TEST(RollingSlip, IsHeldAgainstTheVehiclesChannel) {
  const Scene& scene = Known("tyre-braking");
  const Measured m = scene.Exact();
  const MaterialVelocity velocity = VelocityOfMaterial(m.frames(), scene.wheel().neighbours());
  SampledSignal channel;
  for (int k = 0; k < 100; ++k) {
    channel.time_s.push_back(0.005 * k + 0.2);
    channel.value.push_back(1407);
  }
  const auto speed = SpeedFromChannel(channel, m.now.time_s, 0.04, {.offset_s = 0.237}, 1.4);
  ASSERT_TRUE(speed.has_value());
  const auto slip_with = [&](const std::optional<MeasuredScalar>& radius) {
    return MeasureSlip(velocity, m.frames(), m.wheel, m.now.contact, scene.wheel().neighbours(),
                       radius, speed);
  };
  const RollingSlip slip = slip_with(MeasuredScalar{389, 0, {}});
  EXPECT_NEAR(slip.channel_excess_mm_s.value, 7, 0.5);
  EXPECT_NEAR(slip.ratio_by_channel.value, 0.97 * 1400 / 1407 - 1, 1e-4);
  EXPECT_NEAR(slip.ratio_by_channel.sigma_random, 0.97 * speed->sigma_random / 1407, 1e-5);
  EXPECT_NE(slip_with(std::nullopt).problem.find("does not tell it"), std::string::npos);
}

TEST(SpeedFromChannel, IsTheMeanOverTheInterval) {
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  const auto truth = [](double t) { return 1400 + 900 * t; };
  constexpr double kSigma = 3, kOffset_s = 0.31, kSigmaOffset_s = 0.004;
  double squares = 0;
  constexpr int kDraws = 400;
  for (int draw = 0; draw < kDraws; ++draw) {
    SampledSignal channel;
    for (double t = 0; t < 1; t += 0.013) {
      channel.time_s.push_back(t + kOffset_s);
      channel.value.push_back(truth(t) + kSigma * normal(random));
    }
    const ClockOffset offset{.offset_s = kOffset_s + kSigmaOffset_s * normal(random),
                             .sigma_s = kSigmaOffset_s};
    const auto speed = SpeedFromChannel(channel, 0.5, 0.04, offset, kSigma);
    ASSERT_TRUE(speed.has_value());
    squares += std::pow((speed->value - truth(0.5)) / speed->sigma_random, 2) / kDraws;
  }
  EXPECT_NEAR(squares, 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(SpeedFromChannel, IsNotThereOverADropout) {
  SampledSignal channel{{0, 1, 2, 3, 4}, {5, 5, NAN, 5, 5}};
  EXPECT_TRUE(SpeedFromChannel(channel, 0.5, 0.2, {}, 0).has_value());
  EXPECT_FALSE(SpeedFromChannel(channel, 1.5, 0.2, {}, 0).has_value());
  EXPECT_FALSE(SpeedFromChannel(channel, 3.95, 0.2, {}, 0).has_value());
  EXPECT_FALSE(SpeedFromChannel(channel, -0.05, 0.2, {}, 0).has_value());
}

}  // namespace
}  // namespace plumbline
