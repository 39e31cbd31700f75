#include "track/ground_observation.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>
#include <vector>

#include "tests/support/tyre_frames.h"

namespace plumbline {
namespace {

using Of = PoseObservation::Of;
using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

constexpr double kDegree = std::numbers::pi / 180;

GroundObservation Observe(const TyreFrame& frame, double sigma_mm, int shared) {
  const auto neighbours = NeighbourCorrelation::OfOverlap(frame.point_mm.size(), frame.step_px,
                                                          shared * frame.step_px / 2 * 2 + 1, 1);
  const double area = shared * shared;
  GroundObservationOptions options;
  options.flat.correlation_area_points = area;
  options.levels.correlation_area_points = area;
  options.symmetry.correlation_area_points = area;
  const Image<double> left_out(frame.thickness_mm.size(), 0);
  return ObserveGround({.time_s = frame.time_s,
                        .point_mm = frame.point_mm,
                        .cov_mm2 = frame.cov_mm2,
                        .thickness_mm = frame.thickness_mm,
                        .left_out_mm = left_out,
                        .sigma_mm = sigma_mm},
                       frame.axis, {}, neighbours, options);
}

// The run's observations, tops linked by the true way of the wheel.
std::vector<PoseObservation> ObserveRun(const VirtualRig& rig, int frames, double sigma_mm,
                                        std::mt19937& random, std::vector<TyreFrame>* truth) {
  std::vector<GroundObservation> seen;
  std::vector<double> travel_mm;
  for (int f = 0; f < frames; ++f) {
    truth->push_back(TrueTyreFrame(rig, f, 10));
    seen.push_back(Observe(WithNoise(truth->back(), sigma_mm, 2, random), sigma_mm, 2));
    travel_mm.push_back(rig.tyre()->Wheel(rig.FrameTime(f)).travel_mm);
  }
  LinkTops(travel_mm, seen);
  std::vector<PoseObservation> poses;
  for (GroundObservation& one : seen) poses.push_back(std::move(one.pose));
  return poses;
}

TEST(GroundObservation, TurnsOfABarsTopAreAsSureAsTheyClaim) {
  std::mt19937 random(1);
  double nees = 0, of_noise = 0;
  int count = 0, inside[2] = {0, 0};
  for (const char* name : {"cleat-longitudinal-square38", "cleat-offset-square50"}) {
    const VirtualRig rig(TyreScenario(name, {0.8, -1.5, 0.4}));
    const TyreFrame truth = TrueTyreFrame(rig, 0, 12);
    const RigPose pose = PoseOf(truth.Ground(), truth.axis);
    for (int draw = 0; draw < 40; ++draw) {
      const PoseObservation seen = Observe(WithNoise(truth, 0.05, 2, random), 0.05, 2).pose;
      ASSERT_EQ(seen.of, Of::kTurns) << name << ": " << seen.why;
      EXPECT_TRUE(seen.over_obstacle);
      const Eigen::Vector2d error = (seen.pose - pose).head<2>();
      EXPECT_LT(error.cwiseAbs().maxCoeff(), 0.1 * kDegree);
      const Eigen::Vector2d edge = seen.common[1].head<2>();
      const Eigen::Matrix2d noise = seen.cov.topLeftCorner<2, 2>();
      const Eigen::Matrix2d all = noise + edge * edge.transpose();
      nees += error.dot(all.ldlt().solve(error));
      of_noise += error.dot(noise.ldlt().solve(error));
      for (int k = 0; k < 2; ++k) inside[k] += std::abs(error[k]) < 1.96 * std::sqrt(all(k, k));
      ++count;
    }
  }
  // The edge counts on top of the noise that it is made of.
  EXPECT_NEAR(of_noise / count, 2, 4 * std::sqrt(4.0 / count));
  EXPECT_GT(nees / count, 0.9);
  for (const int k : {0, 1}) EXPECT_GE(inside[k], 0.9 * count) << k;
}

TEST(GroundObservation, WideGroundTellsAsItDidAlone) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  std::mt19937 random(2);
  const TyreFrame frame = WithNoise(TrueTyreFrame(rig, 0, 12), 0.05, 1, random);
  const PoseObservation seen = Observe(frame, 0.05, 1).pose;
  const auto flat = FindFlatContact(frame.point_mm, frame.cov_mm2, frame.thickness_mm, frame.axis);
  ASSERT_TRUE(flat && seen.of == Of::kPlane);
  const PoseObservation alone = ObservePlane(frame.time_s, flat->plane, frame.axis);
  EXPECT_LT((seen.pose - alone.pose).norm(), 1e-9);
  EXPECT_LT((seen.cov - alone.cov).norm(), 1e-6 * alone.cov.norm());
  EXPECT_FALSE(seen.top || seen.over_obstacle);
}

TEST(GroundObservation, ATopAloneTellsTurnsAndWithItsHeightAll) {
  const VirtualRig rig(TyreScenario("cleat-longitudinal-square38", {0.8, -1.5, 0.4}));
  std::mt19937 random(3);
  std::vector<TyreFrame> truth;
  const auto seen = ObserveRun(rig, 3, 0.04, random, &truth);
  const RigRotation alone = SmoothRigRotation(seen, truth[0].axis);
  EXPECT_FALSE(alone.found);
  RigRotationOptions options;
  options.obstacle_height_mm = 38.1;
  options.sigma_obstacle_height_mm = 0.2;
  const RigRotation said = SmoothRigRotation(seen, truth[0].axis, {}, options);
  EXPECT_TRUE(said.found);
  for (std::size_t f = 0; f < seen.size(); ++f) {
    const RigPose pose = PoseOf(truth[f].Ground(), truth[f].axis);
    const RigRotationFrame &without = alone.frames[f], &with = said.frames[f];
    EXPECT_TRUE(without.known[0] && without.known[1] && !without.known[2]);
    EXPECT_NE(without.problem.find("height"), std::string::npos) << without.problem;
    EXPECT_LT((without.pose - pose).head<2>().norm(), 0.1 * kDegree);
    EXPECT_EQ(with.from, RigRotationFrame::From::kObstacle);
    EXPECT_NEAR(with.pose[2] - pose[2], 0.1, 0.05);
    EXPECT_NEAR(with.sigma_random[2], 0.2, 0.02);
  }
}

TEST(GroundObservation, FramesThatTouchBothTellHowHighTheTopIs) {
  const VirtualRig rig(TyreScenario("cleat-diagonal-square50", {0.8, -1.5, 0.4}));
  std::mt19937 random(4);
  std::vector<TyreFrame> truth;
  auto seen = ObserveRun(rig, 8, 0.03, random, &truth);
  const RigRotation linked = SmoothRigRotation(seen, truth[0].axis);
  int bridged = 0, inside = 0;
  for (std::size_t f = 0; f < seen.size(); ++f) {
    const RigRotationFrame& frame = linked.frames[f];
    const double error = frame.pose[2] - PoseOf(truth[f].Ground(), truth[f].axis)[2];
    ASSERT_TRUE(frame.found) << f << ": " << frame.problem;
    EXPECT_LT(std::abs(error), 0.1) << f;
    EXPECT_LT(frame.sigma_random[2], 0.1) << f;
    inside += std::abs(error) < 2.5 * frame.sigma_random[2] ? 1 : 0;
    bridged += seen[f].of == Of::kTurns ? 1 : 0;
  }
  EXPECT_GE(inside, 7);
  EXPECT_GE(bridged, 3);
  for (PoseObservation& one : seen) {
    if (one.top) one.top->as_before = false;
  }
  const RigRotation apart = SmoothRigRotation(seen, truth[0].axis);
  EXPECT_GT(apart.frames[6].sigma_random[2], 3);
}

TEST(GroundObservation, TopsAreLinkedWhereTheGroundCarriesThem) {
  std::vector<GroundObservation> frames(4);
  for (GroundObservation& frame : frames) {
    frame.pose.top.emplace();
    frame.top = {{60, 90}, {-20, 20}};
  }
  frames[1].top.along_mm = {32, 62};     // moved by 28
  frames[2].top.along_mm = {60, 90};     // another one, as far ahead as the first was
  frames[3].top = {{32, 62}, {30, 50}};  // beside it
  LinkTops(std::vector<double>{0, 28, 56, 84}, frames);
  EXPECT_FALSE(frames[0].pose.top->as_before);
  EXPECT_TRUE(frames[1].pose.top->as_before);
  EXPECT_FALSE(frames[2].pose.top->as_before);
  EXPECT_FALSE(frames[3].pose.top->as_before);
  EXPECT_THROW(LinkTops(std::vector<double>{0}, frames), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
