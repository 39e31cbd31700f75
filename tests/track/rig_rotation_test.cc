#include "track/rig_rotation.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <numbers>
#include <random>
#include <span>
#include <vector>

#include "calib/error.h"
#include "fit/flat_contact.h"
#include "tests/support/tyre_frames.h"
#include "track/internal/pose_filter.h"
#include "track/surface_plane.h"

namespace plumbline {
namespace {

using From = RigRotationFrame::From;
using testing::LetTheArmSwing;
using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

constexpr double kDegree = std::numbers::pi / 180;

WheelAxis SomeAxis() { return WheelAxis::Through({21, 3, -224}, {0.03, -1, 0.02}); }

// A plane of the pose with the covariance of a patch of 0.2 m.
PoseObservation Seen(double time_s, const RigPose& pose, std::mt19937& random) {
  Eigen::Matrix3d root;
  root << 1.7e-4, 0, 0, 2e-5, 1.5e-4, 0, 5e-3, 1e-3, 6e-3;
  std::normal_distribution<double> normal;
  RigPose draw = RigPose::Zero();
  for (double& value : draw) value = normal(random);
  PoseObservation frame;
  frame.time_s = time_s;
  frame.of = PoseObservation::Of::kPlane;
  frame.pose = pose + root * draw;
  frame.cov = root * root.transpose();
  return frame;
}

PoseObservation Unseen(double time_s) {
  PoseObservation frame;
  frame.time_s = time_s;
  frame.why = "no part of the surface is flat";
  return frame;
}

TEST(RigPose, IsThatOfItsPlane) {
  const WheelAxis axis = SomeAxis();
  const RigPose pose(0.07, -0.03, 386);
  const GroundPlane plane = PlaneOf(pose, axis);
  EXPECT_LT((PoseOf(plane, axis) - pose).norm(), 1e-12);
  EXPECT_NEAR(plane.e1.cross(plane.e2).dot(plane.normal), 1, 1e-12);
  EXPECT_NEAR(plane.SignedDistance(plane.centroid), 0, 1e-9);
  // A lean of the ground to the left of the wheel brings its normal to the right.
  EXPECT_GT(PlaneOf({0, -0.1, 386}, axis).normal.dot(axis.direction_in_rig()), 0);
}

TEST(RigPose, JacobianIsTheDerivative) {
  const WheelAxis axis = SomeAxis();
  GroundPlane plane = PlaneOf({0.07, -0.03, 386}, axis);
  plane.centroid += 30 * plane.e1 - 12 * plane.e2;
  const Eigen::Matrix3d J = PoseJacobian(plane, axis);
  constexpr double kStep = 1e-5;
  for (int k = 0; k < 3; ++k) {
    const auto moved = [&](double step) {
      GroundPlane other = plane;
      if (k < 2) {
        other.normal = RotationFromVector(step * (k == 0 ? plane.e1 : plane.e2)) * plane.normal;
      }
      other.offset_mm = other.normal.dot(plane.centroid) + (k == 2 ? step : 0);
      return PoseOf(other, axis);
    };
    const RigPose slope = (moved(kStep) - moved(-kStep)) / (2 * kStep);
    EXPECT_LT((slope - J.col(k)).norm(), 1e-6) << k;
  }
}

struct Tally {
  int inside = 0, all = 0;
  double square = 0;
  void Add(double error, double sigma) {
    inside += std::abs(error) < 1.96 * sigma ? 1 : 0;
    square += error * error;
    ++all;
  }
  double coverage() const { return static_cast<double>(inside) / all; }
  double rms() const { return std::sqrt(square / all); }
};

TEST(RigRotation, AStiffArmAveragesAllFrames) {
  std::mt19937 random(1);
  const RigPose truth(-0.063, 0.004, 386);
  Tally tally;
  for (int draw = 0; draw < 20; ++draw) {
    std::vector<PoseObservation> seen;
    for (int f = 0; f < 30; ++f) seen.push_back(Seen(0.02 * f, truth, random));
    const RigRotation rotation = SmoothRigRotation(seen, SomeAxis());
    ASSERT_TRUE(rotation.found);
    EXPECT_EQ(rotation.outliers, 0);
    for (int k = 0; k < 2; ++k) {
      tally.Add(rotation.frames[10].pose[k] - truth[k], rotation.frames[10].sigma_random[k]);
    }
    EXPECT_GT(rotation.frames[10].lean, 0.5);
  }
  EXPECT_LT(tally.rms(), 0.005 * kDegree);
  EXPECT_GT(tally.coverage(), 0.88);
}

// Of the errors of three frames in a row, normalised by what is claimed: all together, and of the
// ground's turn over both intervals by itself. And the turn's sigma, mean.
struct JointErrors {
  double nees = 0, turn = 0, sigma_turn = 0;
};

// Frame 7 says nothing by itself; all frames have an error in common besides. The arm walks as
// it is told to.
JointErrors JointErrorsOf(double pitch_deg_per_sqrt_s, std::size_t first) {
  constexpr int kDraws = 500, kFrames = 14;
  const RigPose common(4e-5, -3e-5, 2e-3);
  RigRotationOptions options;
  options.pitch_deg_per_sqrt_s = pitch_deg_per_sqrt_s;
  options.roll_deg_per_sqrt_s = 0.05;
  options.height_mm_per_sqrt_s = 0.1;
  options.unseen_height_mm_per_sqrt_s = 0;
  std::mt19937 random(8);
  std::normal_distribution<double> normal;
  JointErrors mean;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<PoseObservation> seen;
    std::vector<RigPose> truth;
    RigPose pose(-0.06, 0.004, 386);
    const double off = normal(random);
    for (int f = 0; f < kFrames; ++f) {
      const double t = 0.02 * f;
      truth.push_back(pose);
      seen.push_back(f == 7 ? Unseen(t) : Seen(t, pose + off * common, random));
      if (f != 7) seen.back().common[0] = common;
      pose[0] += pitch_deg_per_sqrt_s * kDegree * std::sqrt(0.02) * normal(random);
      pose[1] += 0.05 * kDegree * std::sqrt(0.02) * normal(random);
      pose[2] += 0.1 * std::sqrt(0.02) * normal(random);
    }
    const RigRotation rotation = SmoothRigRotation(seen, SomeAxis(), {}, options);
    const std::span<const RigRotationFrame> frames(rotation.frames);
    Eigen::Matrix<double, 9, 1> error;
    for (std::size_t k = 0; k < 3; ++k) {
      error.segment<3>(3 * static_cast<Eigen::Index>(k)) =
          frames[first + k].pose - truth[first + k];
    }
    const Eigen::MatrixXd root = RandomRoot(frames.subspan(first, 3));
    mean.nees += error.dot((root * root.transpose()).ldlt().solve(error)) / 9 / kDraws;
    const double sigma = SigmaOfTurn(frames, first, first + 2);
    mean.turn += std::pow((error[6] - error[0]) / sigma, 2) / kDraws;
    mean.sigma_turn += sigma / kDraws;
    EXPECT_LT((RandomCovariance(frames, first, first) - frames[first].cov_random).norm(), 1e-12);
  }
  return mean;
}

TEST(RigRotation, ErrorsOfFramesHangTogetherAsTheySay) {
  constexpr double kWithin = 4 * std::numbers::sqrt2 / 22.36;  // of the mean of 500 squares
  double loose_sigma = 0;
  for (const double walk_deg : {3.0, 0.1, 0.01}) {
    for (const std::size_t first : {4U, 6U, 0U}) {
      const JointErrors errors = JointErrorsOf(walk_deg, first);
      EXPECT_NEAR(errors.nees, 1, kWithin / 3) << walk_deg << ' ' << first;
      EXPECT_NEAR(errors.turn, 1, kWithin) << walk_deg << ' ' << first;
      if (walk_deg == 3.0 && first == 4) loose_sigma = errors.sigma_turn;
      // A stiff arm's errors are the same in all frames, a loose one's are not at all.
      if (walk_deg == 0.01) {
        EXPECT_LT(errors.sigma_turn, 0.2 * loose_sigma);
      }
    }
  }
}

// What an obstacle's edge does to narrow contacts changes its sign as the obstacle passes: a stiff
// arm does not follow it.
TEST(RigRotation, TellsACommonErrorThatAStiffArmContradicts) {
  constexpr int kDraws = 30, kFrames = 12;
  const RigPose truth(-0.06, 0.004, 386);
  std::mt19937 random(12);
  std::normal_distribution<double> normal;
  double nees = 0, squares = 0, squares_untold = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const double off = normal(random);
    std::vector<PoseObservation> told, untold;
    for (int f = 0; f < kFrames; ++f) {
      const RigPose common((f < 6 ? 3e-4 : -3e-4) * (f % 3), 0, 0);
      untold.push_back(Seen(0.02 * f, truth + off * common, random));
      told.push_back(untold.back());
      told.back().common[1] = common;
    }
    const RigRotation with = SmoothRigRotation(told, SomeAxis());
    const RigRotation without = SmoothRigRotation(untold, SomeAxis());
    for (std::size_t f = 0; f < kFrames; ++f) {
      const double error = with.frames[f].pose[0] - truth[0];
      squares += error * error;
      squares_untold += std::pow(without.frames[f].pose[0] - truth[0], 2);
      nees += std::pow(error / with.frames[f].sigma_random[0], 2) / (kDraws * kFrames);
    }
  }
  EXPECT_LT(squares, 0.2 * squares_untold);
  EXPECT_GT(nees, 0.5);
  EXPECT_LT(nees, 1.5);
}

// With rates, and a top that is stood on: all that the state has.
TEST(RigRotation, ErrorsOfFramesHangTogetherWithRates) {
  constexpr int kDraws = 1000, kFrames = 10;
  internal::PoseModel model;
  model.with_rate = true;
  model.noise = RigPose(0.02, 1e-3, 5);  // rad, rad, mm a s^1.5 (roll: sqrt(s))
  model.prior = RigPose(-0.06, 0.004, 386);
  model.prior_sigma = RigPose(0.01, 0.01, 5);
  model.obstacle_mm = 20;
  model.sigma_obstacle_mm = 10;
  std::mt19937 random(9);
  std::normal_distribution<double> normal;
  double nees = 0, turn = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    RigPose pose, rate(0.35 * normal(random), 0, 200 * normal(random));
    for (int k = 0; k < 3; ++k) pose[k] = model.prior[k] + model.prior_sigma[k] * normal(random);
    const double top_mm = model.obstacle_mm + model.sigma_obstacle_mm * normal(random);
    std::vector<PoseObservation> seen;
    std::vector<RigPose> truth;
    for (int f = 0; f < kFrames; ++f) {
      truth.push_back(pose);
      PoseObservation frame = Seen(0.02 * f, pose, random);
      if (f > 2) {
        frame.top.emplace();
        frame.top->below_axis_mm = pose[2] - top_mm + 4e-3 * normal(random);
        frame.top->cov = Eigen::Vector4d(0, 0, 0, 1.6e-5);
        frame.top->as_before = true;
        if (f > 4) frame.of = PoseObservation::Of::kTurns;
      }
      seen.push_back(frame);
      for (const int k : {0, 2}) {
        // The white noise of the rate, and what it has moved the place by meanwhile.
        const double q = model.noise[k], dt = 0.02, a = normal(random), b = normal(random);
        const double rate_by = q * std::sqrt(dt) * a;
        pose[k] += rate[k] * dt + dt / 2 * rate_by + q * std::sqrt(dt * dt * dt / 12) * b;
        rate[k] += rate_by;
      }
      pose[1] += model.noise[1] * std::sqrt(0.02) * normal(random);
    }
    const std::vector<internal::SmoothedPose> poses =
        internal::SmoothPoses(seen, std::vector<std::uint8_t>(kFrames, 1), model);
    std::vector<RigRotationFrame> frames(3);
    Eigen::Matrix<double, 9, 1> error;
    for (std::size_t k = 0; k < 3; ++k) {
      frames[k].errors = poses[5 + k].errors;
      error.segment<3>(3 * static_cast<Eigen::Index>(k)) = poses[5 + k].pose - truth[5 + k];
    }
    const Eigen::MatrixXd root = RandomRoot(frames);
    nees += error.dot((root * root.transpose()).ldlt().solve(error)) / 9 / kDraws;
    turn += std::pow((error[6] - error[0]) / SigmaOfTurn(frames, 0, 2), 2) / kDraws;
  }
  EXPECT_NEAR(nees, 1, 4 * std::sqrt(2.0 / 9 / kDraws));
  EXPECT_NEAR(turn, 1, 4 * std::sqrt(2.0 / kDraws));
}

RigPose Swing(double time_s) {
  return {3 * kDegree * std::sin(6.28 * time_s), 0.01, 386 + 2 * std::sin(20 * time_s)};
}

TEST(RigRotation, FollowsASwingingArmAndBridgesGaps) {
  std::mt19937 random(2);
  Tally seen_tally, gap_tally;
  for (int draw = 0; draw < 12; ++draw) {
    std::vector<PoseObservation> seen;
    const auto in_gap = [](int f) { return (f >= 20 && f < 26) || (f >= 38 && f < 41); };
    for (int f = 0; f < 60; ++f) {
      const double t = 0.02 * f;
      seen.push_back(in_gap(f) ? Unseen(t) : Seen(t, Swing(t), random));
    }
    const RigRotation rotation = SmoothRigRotation(seen, SomeAxis());
    EXPECT_TRUE(rotation.with_rate);
    for (int f = 0; f < 60; ++f) {
      const RigRotationFrame& frame = rotation.frames[static_cast<std::size_t>(f)];
      ASSERT_TRUE(frame.found) << frame.problem;
      (in_gap(f) ? gap_tally : seen_tally)
          .Add(frame.pose[0] - Swing(frame.time_s)[0], frame.sigma_random[0]);
      EXPECT_EQ(frame.from, in_gap(f) ? From::kSmoother : From::kPlane);
      EXPECT_EQ(frame.lean == 1, in_gap(f));
      EXPECT_EQ(frame.problem.empty(), !in_gap(f));
    }
    EXPECT_GT(rotation.frames[23].sigma_random[0], 2 * rotation.frames[10].sigma_random[0]);
    EXPECT_GT(rotation.frames[23].sigma_random[2], 3);
  }
  EXPECT_LT(seen_tally.rms(), 0.012 * kDegree);
  EXPECT_LT(gap_tally.rms(), 0.05 * kDegree);
  EXPECT_NEAR(seen_tally.coverage(), 0.95, 0.03);
  EXPECT_GT(gap_tally.coverage(), 0.93);
}

TEST(RigRotation, LeavesAWrongPlaneOut) {
  for (const int wrong : {0, 7, 19}) {
    std::mt19937 random(3);
    std::vector<PoseObservation> seen;
    for (int f = 0; f < 20; ++f) {
      seen.push_back(Seen(0.02 * f, RigPose(-0.06, 0.004, 386), random));
    }
    seen[static_cast<std::size_t>(wrong)].pose += RigPose(0.01, -0.02, -38);
    const RigRotation rotation = SmoothRigRotation(seen, SomeAxis());
    EXPECT_EQ(rotation.outliers, 1) << wrong;
    const RigRotationFrame& frame = rotation.frames[static_cast<std::size_t>(wrong)];
    EXPECT_EQ(frame.from, From::kOutlier);
    EXPECT_EQ(frame.lean, 1);
    EXPECT_LT(std::abs(frame.pose[0] + 0.06), 0.01 * kDegree);
    EXPECT_FALSE(frame.problem.empty());
  }
}

TEST(RigRotation, NoiseThatIsGivenIsTaken) {
  std::mt19937 random(4);
  std::vector<PoseObservation> seen;
  for (int f = 0; f < 20; ++f) {
    seen.push_back(Seen(0.02 * f, RigPose(-0.06, 0.004, 386), random));
    const RigPose variance = seen.back().cov.diagonal();
    seen.back().cov = variance.asDiagonal();
  }
  RigRotationOptions options;
  options.pitch_deg_per_sqrt_s = 100;
  options.roll_deg_per_sqrt_s = 0;
  const RigRotation loose = SmoothRigRotation(seen, SomeAxis(), {}, options);
  EXPECT_FALSE(loose.with_rate);
  // Each frame by itself in pitch, all together in roll.
  EXPECT_NEAR(loose.frames[9].sigma_random[0], std::sqrt(seen[9].cov(0, 0)), 1e-6);
  EXPECT_NEAR(loose.frames[9].sigma_random[1], std::sqrt(seen[9].cov(1, 1) / 20), 3e-6);
  EXPECT_NEAR(loose.frames[9].lean, 0.475, 0.01);
}

TEST(RigRotation, ModesGoThroughTheSameGains) {
  std::mt19937 random(5);
  std::vector<PoseObservation> seen, shifted;
  std::normal_distribution<double> normal;
  for (int f = 0; f < 25; ++f) {
    const double t = 0.02 * f;
    PoseObservation frame = f % 9 == 5 ? Unseen(t) : Seen(t, Swing(t), random);
    shifted.push_back(frame);
    if (frame.of == PoseObservation::Of::kPlane) {
      const RigPose change = RigPose(3e-4, -1e-4, 0.2) * (1 + 0.02 * f);
      frame.along_modes = {RigPose::Zero(), change};
      shifted.back().pose += change;
    }
    seen.push_back(frame);
  }
  RigRotationOptions options;
  options.pitch_deg_per_sqrt_s = 2;
  options.roll_deg_per_sqrt_s = 0.1;
  options.height_mm_per_sqrt_s = 50;
  const RigRotation rotation = SmoothRigRotation(seen, SomeAxis(), {}, options);
  const RigRotation along = SmoothRigRotation(shifted, SomeAxis(), {}, options);
  for (std::size_t f = 0; f < seen.size(); ++f) {
    const RigRotationFrame& frame = rotation.frames[f];
    ASSERT_TRUE(frame.found && along.frames[f].found) << frame.problem;
    EXPECT_LT(frame.along_modes[0].norm(), 1e-15);
    EXPECT_LT((along.frames[f].pose - frame.pose - frame.along_modes[1]).head<2>().norm(), 1e-7);
    EXPECT_NEAR(along.frames[f].pose[2] - frame.pose[2], frame.along_modes[1][2], 1e-4);
    EXPECT_LT((frame.sigma_calibration - frame.along_modes[1].cwiseAbs()).norm(), 1e-12);
    // The ground frame along the mode is that of the shifted frames.
    const Rigid3 difference =
        along.frames[f].ground.frame_from_rig * frame.ground.along_modes[1].Inverse();
    EXPECT_LT(difference.RotationVector().norm(), 1e-6);
    EXPECT_LT(difference.translation_mm.norm(), 1e-3);
  }
}

TEST(RigRotation, RefusesWhatCannotBe) {
  std::mt19937 random(6);
  std::vector<PoseObservation> seen = {Seen(0.02, {0, 0, 386}, random),
                                       Seen(0.02, {0, 0, 386}, random)};
  EXPECT_THROW((void)SmoothRigRotation(seen, SomeAxis()), InputError);
  seen[1].time_s = 0.04;
  seen[1].along_modes.emplace_back(0, 0, 0);
  EXPECT_THROW((void)SmoothRigRotation(seen, SomeAxis()), std::invalid_argument);
  RigRotationOptions options;
  options.pitch_deg_per_sqrt_s = -1;
  EXPECT_THROW((void)SmoothRigRotation({}, SomeAxis(), {}, options), UsageError);
  const std::vector<PoseObservation> nothing = {Unseen(0), Unseen(0.02)};
  const RigRotation none = SmoothRigRotation(nothing, SomeAxis());
  EXPECT_FALSE(none.found);
  EXPECT_FALSE(none.problem.empty());
  ASSERT_EQ(none.frames.size(), 2U);
  EXPECT_EQ(none.frames[1].problem, nothing[1].why);
}

TEST(ManualGround, TurnsAboutXThenYThenZ) {
  Image<Eigen::Vector3d> undeformed({2, 1}, Eigen::Vector3d(10, 20, 160));
  undeformed(0, 1) = Eigen::Vector3d(-30, 5, 150);
  const Rigid3 ground = ManualGround({157, 0, 0}, undeformed);
  EXPECT_NEAR(std::min((ground * undeformed(0, 0)).z(), (ground * undeformed(0, 1)).z()), 0, 1e-12);
  // A camera that looks down has the ground's z against its own.
  EXPECT_NEAR(ground.rotation(2, 2), std::cos(157 * kDegree), 1e-12);
  EXPECT_NEAR(ground.rotation(2, 1), std::sin(157 * kDegree), 1e-12);
  const Rigid3 turned = ManualGround({180, 0, 90}, undeformed, SomeAxis());
  EXPECT_LT((turned.rotation * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(), 1e-12);
  EXPECT_LT((turned * SomeAxis().origin_in_rig_mm()).head<2>().norm(), 1e-9);
  EXPECT_THROW((void)ManualGround({0, 0, 0}, Image<Eigen::Vector3d>()), InputError);
}

// What the points of a frame say: the plane, else the pitch from the symmetry.
PoseObservation Observe(const TyreFrame& frame, double sigma_mm, int shared) {
  const double area = shared * shared;
  std::string why, why_not_symmetric;
  auto flat =
      FindFlatContact(frame.point_mm, frame.cov_mm2, frame.thickness_mm, frame.axis, {}, &why);
  if (flat) {
    const Image<Eigen::Vector3d> outer =
        OuterPoints(frame.point_mm, frame.thickness_mm, flat->plane.normal);
    std::vector<std::size_t> places(outer.pixel_count());
    for (std::size_t i = 0; i < places.size(); ++i) places[i] = i;
    const auto neighbours = NeighbourCorrelation::OfOverlap(outer.size(), frame.step_px,
                                                            shared * frame.step_px / 2 * 2 + 1, 1);
    flat->plane.cov = PlaneCovariance(
        flat->plane, {outer.values(), frame.cov_mm2.values(), places, outer.size()}, neighbours);
    return ObservePlane(frame.time_s, flat->plane, frame.axis);
  }
  const auto symmetry = FindSymmetry(frame.point_mm, sigma_mm, frame.axis, 0,
                                     {.correlation_area_points = area}, &why_not_symmetric);
  PoseObservation result = symmetry ? ObservePitch(frame.time_s, *symmetry) : Unseen(frame.time_s);
  result.why = symmetry ? why : why + "; " + why_not_symmetric;
  return result;
}

// Runs a scenario of the virtual rig with several draws of noise.
struct VirtualRun {
  Tally pitch, roll, own;
  int bridged = 0, frames = 0, not_found = 0;
};

VirtualRun RunScenario(const Scenario& scenario, double sigma_mm, int shared, int draws,
                       const RigRotationOptions& options = {}) {
  const VirtualRig rig(scenario);
  std::vector<TyreFrame> truth;
  for (const int f : rig.Recorded()) truth.push_back(TrueTyreFrame(rig, f, 12));
  std::mt19937 random(7);
  VirtualRun run;
  for (int draw = 0; draw < draws; ++draw) {
    std::vector<PoseObservation> seen;
    for (const TyreFrame& frame : truth) {
      seen.push_back(Observe(WithNoise(frame, sigma_mm, shared, random), sigma_mm, shared));
    }
    const RigRotation rotation = SmoothRigRotation(seen, truth.front().axis, {}, options);
    for (std::size_t f = 0; f < truth.size(); ++f) {
      const RigPose pose = PoseOf(truth[f].Ground(), truth[f].axis);
      const RigRotationFrame& frame = rotation.frames[f];
      const RigPose error = frame.pose - pose;
      run.pitch.Add(error[0], frame.sigma_random[0]);
      run.roll.Add(error[1], frame.sigma_random[1]);
      if (seen[f].of == PoseObservation::Of::kPlane) {
        run.own.Add(seen[f].pose[0] - pose[0], std::sqrt(seen[f].cov(0, 0)));
      }
      run.bridged += frame.from == From::kSmoother ? 1 : 0;
      run.not_found += frame.found ? 0 : 1;
      ++run.frames;
      if (!frame.found) continue;
      const Rigid3 residual = frame.ground.frame_from_rig * truth[f].ground_from_rig.Inverse();
      EXPECT_LT(residual.RotationVector().head<2>().norm(), 0.01);
      EXPECT_LT(residual.translation_mm.head<2>().norm(), 4);
    }
  }
  return run;
}

TEST(RigRotation, OfTheVirtualTyreOnFlatGround) {
  // Mounted by 3 degrees either way, and swinging by as much.
  for (const double pitch_deg : {-3.0, 3.0}) {
    Scenario scenario = TyreScenario("tyre-flat", {0.8, -1.5 + pitch_deg, 0.4});
    LetTheArmSwing(scenario);
    scenario.frames = 5;
    const VirtualRun run = RunScenario(scenario, 0.08, pitch_deg > 0 ? 3 : 1, 2);
    EXPECT_LT(run.pitch.rms(), 0.03 * kDegree);
    EXPECT_LT(run.roll.rms(), 0.03 * kDegree);
    EXPECT_GT(run.pitch.coverage(), 0.85);
    EXPECT_EQ(run.not_found, 0);
    EXPECT_EQ(run.bridged, 0);
  }
}

TEST(RigRotation, OfTheVirtualTyreOverObstacles) {
  Tally pitch, roll, own;
  const auto add = [](Tally& to, const Tally& from) {
    to.inside += from.inside;
    to.all += from.all;
    to.square += from.square;
  };
  struct Case {
    const char* scenario;
    int frames;
  };
  for (const Case& c : {Case{"nuts", 9}, Case{"tyre-disturbed", 12}}) {
    Scenario scenario = TyreScenario(c.scenario, {0.8, -1.5, 0.4});
    LetTheArmSwing(scenario);
    scenario.frames = c.frames;
    const VirtualRun run = RunScenario(scenario, 0.06, 2, 2);
    EXPECT_LT(run.pitch.rms(), 0.1 * kDegree) << c.scenario;
    EXPECT_LT(run.roll.rms(), 0.1 * kDegree) << c.scenario;
    EXPECT_EQ(run.not_found, 0) << c.scenario;
    EXPECT_GT(run.bridged, 0) << c.scenario;
    add(pitch, run.pitch);
    add(roll, run.roll);
    add(own, run.own);
  }
  // Few and, over a gap, not independent: what bad sigmas would miss by far.
  EXPECT_GT(pitch.coverage(), 0.8);
  EXPECT_GT(roll.coverage(), 0.8);
  EXPECT_GT(own.coverage(), 0.8);
}

TEST(RigRotation, OverARidgeAlongTheWayNeedsToKnowRollAndHeight) {
  Scenario scenario = TyreScenario("cleat-longitudinal-angle40", {0.8, 1.5, 0.4});
  scenario.frames = 3;
  const VirtualRun without = RunScenario(scenario, 0.06, 2, 1);
  EXPECT_EQ(without.not_found, without.frames);
  EXPECT_LT(without.pitch.rms(), 0.1 * kDegree);  // that of the symmetry
  RigRotationOptions options;
  options.prior = RigPose(0, 0, 393);  // as from a run on flat ground, and the iron's height
  options.prior_sigma = RigPose(std::numeric_limits<double>::infinity(), 5e-4, 3);
  const VirtualRun with = RunScenario(scenario, 0.06, 2, 1, options);
  EXPECT_EQ(with.not_found, 0);
  EXPECT_LT(with.pitch.rms(), 0.1 * kDegree);
}

}  // namespace
}  // namespace plumbline
