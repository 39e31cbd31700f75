#include "track/patch_series.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstdio>

#include "calib/error.h"
#include "io/virtual_rig/tyre_patch.h"
#include "tests/support/tyre_frames.h"

namespace plumbline {
namespace {

using testing::TrueTyreFrame;
using testing::TyreFrame;
using testing::TyreScenario;
using testing::WithNoise;

PatchFrame FrameOf(const TyreFrame& frame) {
  PatchFrame result;
  result.point_mm = frame.point_mm;
  result.undeformed_mm = frame.undeformed_mm;
  result.thickness_mm = frame.thickness_mm;
  result.cov_mm2 = frame.cov_mm2;
  result.rotation.found = true;
  result.rotation.from = RigRotationFrame::From::kPlane;
  result.rotation.pose = PoseOf(frame.Ground(), frame.axis);
  result.rotation.ground.frame_from_rig = frame.ground_from_rig;
  return result;
}

std::vector<PatchFrame> Draws(const TyreFrame& truth, int count, double sigma_mm, int shared) {
  std::mt19937 random(1);
  std::vector<PatchFrame> frames;
  for (int k = 0; k < count; ++k) {
    frames.push_back(FrameOf(WithNoise(truth, sigma_mm, shared, random)));
  }
  return frames;
}

// As WithNoise() shares it.
NeighbourCorrelation Neighbours(const TyreFrame& frame, int shared) {
  return NeighbourCorrelation::OfOverlap(frame.point_mm.size(), 100, 100 * shared + 1, 1);
}

PatchSeriesOptions Options(double sigma_mm, int shared) {
  PatchSeriesOptions options;
  options.sigma_mm = sigma_mm;
  options.correlation_area_points = shared * shared;
  return options;
}

// Without what the law leaves out.
PatchSeriesOptions NoiseAlone(double sigma_mm, int shared) {
  PatchSeriesOptions options = Options(sigma_mm, shared);
  options.sigma_depth_mm = options.sigma_ellipse_mm = 0;
  return options;
}

TEST(PatchSeries, FindsWhatTouchesTheGround) {
  for (const char* name : {"tyre-flat", "tyre-braking", "tyre-cornering"}) {
    const VirtualRig rig(TyreScenario(name, {0.8, -1.5, 0.4}));
    const TyreFrame truth = TrueTyreFrame(rig, 0, 8);
    const auto patch = FindPatch(*rig.tyre(), 0);
    const PatchSeries series =
        FindPatches(Draws(truth, 16, 0.05, 2), truth.axis, Neighbours(truth, 2), Options(0.05, 2));
    ASSERT_TRUE(series.law.has_value());
    for (const FramePatch& record : series.frames) {
      ASSERT_EQ(record.by, FramePatch::By::kLiftOff) << record.problem;
      EXPECT_NEAR(record.patch.area_mm2 / patch->area_mm2, 1, 0.01) << name;
      EXPECT_NEAR(record.patch.length_mm, patch->length_mm, 1) << name;
      EXPECT_NEAR(record.patch.width_mm, patch->width_mm, 1) << name;
      EXPECT_LT((record.patch.centroid_mm - patch->centroid_mm).norm(), 0.7) << name;
      // Within the threshold, a quarter more.
      EXPECT_GT(record.within_threshold->area_mm2, 1.2 * patch->area_mm2);
      EXPECT_TRUE(record.patch.complete());
    }
  }
}

TEST(PatchSeries, SigmasAreThoseOfSampling) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  const TyreFrame truth = TrueTyreFrame(rig, 0, 12);
  constexpr int kDraws = 40;
  const auto frames = Draws(truth, kDraws, 0.05, 1);
  PatchSeriesOptions options = NoiseAlone(0.05, 1);
  // The law held: the scatter of the frames is that of their own noise.
  options.law = FindPatches(frames, truth.axis, Neighbours(truth, 1), options).law;
  const LiftOffLaw law = *options.law;
  options.law->cov.setZero();
  const PatchSeries own = FindPatches(frames, truth.axis, Neighbours(truth, 1), options);
  FramePatch::Results sum = FramePatch::Results::Zero(), square = sum, claimed = sum;
  for (const FramePatch& record : own.frames) {
    const FramePatch::Results r = record.patch.results();
    sum += r / kDraws;
    square += r.cwiseAbs2() / kDraws;
    claimed += record.sigma_random / kDraws;
  }
  const FramePatch::Results scatter = (square - sum.cwiseAbs2()).cwiseSqrt();
  for (const int k : {0, 1, 2, 3, 4}) EXPECT_NEAR(scatter[k] / claimed[k], 1, 0.4) << k;
  // The law of half the frames differs from that of the others as its sigma says.
  const std::span<const PatchFrame> all(frames);
  PatchSeriesOptions free = NoiseAlone(0.05, 1);
  double nees = 0;
  for (int part = 0; part < 4; ++part) {
    const LiftOffLaw one = *FindPatches(all.subspan(static_cast<std::size_t>(10 * part), 10),
                                        truth.axis, Neighbours(truth, 1), free)
                                .law;
    // Of the next term both have the same prior.
    const Eigen::Vector2d d(one.log_k - law.log_k, one.m - law.m);
    nees += d.dot((one.cov.topLeftCorner<2, 2>() * 0.75).inverse() * d) / 4;
  }
  EXPECT_GT(nees, 0.1);
  EXPECT_LT(nees, 6);
}

// As that of frames over obstacles alone can be.
TEST(PatchSeries, DoesNotBelieveALawByWhichLittleTouches) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  const TyreFrame truth = TrueTyreFrame(rig, 0, 12);
  const auto frames = Draws(truth, 2, 0.02, 1);
  PatchSeriesOptions options = Options(0.02, 1);
  options.lift_off.max_scatter_mm = 10;
  options.law = FindPatches(frames, truth.axis, Neighbours(truth, 1), options).law;
  EXPECT_EQ(FindPatches(frames, truth.axis, Neighbours(truth, 1), options).frames[0].by,
            FramePatch::By::kLiftOff);
  options.law->log_k -= 6;
  const FramePatch record =
      FindPatches(frames, truth.axis, Neighbours(truth, 1), options).frames[0];
  EXPECT_EQ(record.by, FramePatch::By::kThreshold);
  EXPECT_NE(record.problem.find("law of lift-off does not hold"), std::string::npos)
      << record.problem;
  EXPECT_GT(record.sigma_random[0], 0);
}

TEST(PatchSeries, TheGroundsErrorIsInIt) {
  const VirtualRig rig(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  const TyreFrame truth = TrueTyreFrame(rig, 0, 12);
  auto frames = Draws(truth, 3, 0.02, 1);
  PatchSeriesOptions options = NoiseAlone(0.02, 1);
  options.law = FindPatches(frames, truth.axis, Neighbours(truth, 1), options).law;
  const PatchSeries exact = FindPatches(frames, truth.axis, Neighbours(truth, 1), options);
  // 0.1 mm of height, as noise in one and as a calibration mode in another frame.
  frames[1].rotation.cov_random = Eigen::Vector3d(1e-12, 1e-12, 0.01).asDiagonal();
  frames[2].along_modes_mm.emplace_back(truth.point_mm.size(), Eigen::Vector3f::Zero());
  Rigid3 higher = truth.ground_from_rig;
  higher.translation_mm.z() += 0.1;
  frames[2].rotation.ground.along_modes = {higher};
  const PatchSeries unsure = FindPatches(frames, truth.axis, Neighbours(truth, 1), options);
  EXPECT_GT(unsure.frames[1].sigma_random[0], 2 * exact.frames[1].sigma_random[0]);
  EXPECT_NEAR(unsure.frames[2].sigma_calibration[0],
              std::sqrt(std::pow(unsure.frames[1].sigma_random[0], 2) -
                        std::pow(exact.frames[1].sigma_random[0], 2)),
              0.3 * unsure.frames[2].sigma_calibration[0]);
}

// In a frame over a bar, of which the tyre touches the ground before it alone.
class WithinThreshold : public ::testing::Test {
 protected:
  static TyreFrame Truth() {
    const VirtualRig rig(TyreScenario("cleat-lateral-square38", {0.8, -1.5, 0.4}));
    TyreFrame truth = TrueTyreFrame(rig, 3, 8);
    std::mt19937 random(1);
    truth.cov_mm2 = WithNoise(truth, 0.03, 2, random).cov_mm2;
    truth.ground_from_rig = GroundOf(PoseOf(truth.Ground(), truth.axis), truth.axis);
    return truth;
  }
  // No frame for a law.
  static PatchFrame OverObstacle(const TyreFrame& frame) {
    PatchFrame result = FrameOf(frame);
    result.rotation.from = RigRotationFrame::From::kObstacle;
    return result;
  }
  FramePatch Find(const PatchFrame& frame) const {
    return FindPatches(std::span(&frame, 1), truth_.axis, Neighbours(truth_, 2), Options(0.03, 2))
        .frames.front();
  }
  const TyreFrame truth_ = Truth();
};

TEST_F(WithinThreshold, SigmasFromNoiseAreThoseOfSampling) {
  const FramePatch exact = Find(OverObstacle(truth_));
  ASSERT_EQ(exact.by, FramePatch::By::kThreshold);
  ASSERT_TRUE(exact.patch.complete());
  // Points, and the ground.
  const Eigen::Vector3d sigma_pose(5e-5, 8e-5, 0.004);
  constexpr int kDraws = 400;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  Eigen::Array<double, ContactPatch::kResults, 1> squares =
      Eigen::Array<double, ContactPatch::kResults, 1>::Zero();
  Eigen::Array<double, ContactPatch::kResults, 1> covered = squares;
  for (int draw = 0; draw < kDraws; ++draw) {
    PatchFrame frame = OverObstacle(WithNoise(truth_, 0.03, 2, random));
    RigRotationFrame& rotation = frame.rotation;
    for (int k = 0; k < 3; ++k) rotation.pose[k] += sigma_pose[k] * normal(random);
    rotation.cov_random = sigma_pose.cwiseAbs2().asDiagonal();
    rotation.ground.frame_from_rig = GroundOf(rotation.pose, truth_.axis);
    const FramePatch drawn = Find(frame);
    const auto off =
        ((drawn.patch.results() - exact.patch.results()).array() / drawn.sigma_random.array())
            .eval();
    squares += off.square() / kDraws;
    covered += (off.abs() < 1.96).cast<double>() / kDraws;
  }
  for (int k = 0; k < ContactPatch::kResults; ++k) {
    std::printf("%d: mean squared error in sigmas %.2f, 95 %% intervals hold %.1f %%\n", k,
                squares[k], 100 * covered[k]);
    // Those of length, by the outermost of many corners, are rough.
    const bool extent = k == 1 || k == 2 || k == 5;
    EXPECT_NEAR(squares[k], 1, extent ? 0.35 : 0.2) << k;
    EXPECT_GT(covered[k], extent ? 0.92 : 0.93) << k;
  }
}

TEST_F(WithinThreshold, ErrorsInCommonCancelWhereTheyAreOfPointsAndGround) {
  PatchFrame frame = OverObstacle(truth_);
  const auto sigma_along = [&](const Eigen::Vector3d& points_in_ground_mm, double ground_mm,
                               double thickness_mm) {
    const Eigen::Vector3d shift = truth_.ground_from_rig.rotation.transpose() * points_in_ground_mm;
    frame.along_modes_mm.assign(
        1, Image<Eigen::Vector3f>(truth_.point_mm.size(), shift.cast<float>()));
    Rigid3 ground = truth_.ground_from_rig;
    ground.translation_mm.z() -= ground_mm;
    frame.rotation.ground.along_modes = {ground};
    frame.thickness_along_modes.assign(1, truth_.thickness_mm);
    for (double& t : frame.thickness_along_modes[0].values()) t += thickness_mm;
    return Find(frame).sigma_calibration;
  };
  const FramePatch exact = Find(frame);
  constexpr double kUp_mm = 0.01;
  const double change = kUp_mm * exact.patch.d_area_d_threshold_mm;
  const Eigen::Vector3d up(0, 0, kUp_mm);
  EXPECT_NEAR(sigma_along(up, 0, 0)[0], change, 0.02 * change);
  EXPECT_NEAR(sigma_along({0, 0, 0}, kUp_mm, 0)[0], change, 0.02 * change);
  EXPECT_NEAR(sigma_along({0, 0, 0}, 0, kUp_mm)[0], change, 0.02 * change);
  EXPECT_LT(sigma_along(up, kUp_mm, 0)[0], 0.001 * change);
  EXPECT_LT(sigma_along(up, 0, kUp_mm)[0], 0.001 * change);
  EXPECT_NEAR(sigma_along({kUp_mm, 0, 0}, 0, 0)[3], kUp_mm, 1e-5);
}

TEST(PatchSeries, FallsBackOnTheThresholdOverAnObstacleAndSaysSo) {
  const VirtualRig rig(TyreScenario("cleat-longitudinal-square38", {0.8, -1.5, 0.4}));
  const VirtualRig flat(TyreScenario("tyre-flat", {0.8, -1.5, 0.4}));
  const TyreFrame ground = TrueTyreFrame(flat, 0, 12);
  std::vector<PatchFrame> frames = Draws(ground, 2, 0.05, 1);
  frames.push_back(FrameOf(TrueTyreFrame(rig, 0, 12)));
  frames.push_back(frames.front());
  frames.back().rotation.found = false;
  frames.back().rotation.problem = "it was dark";
  const PatchSeries series =
      FindPatches(frames, ground.axis, Neighbours(ground, 1), Options(0.05, 1));
  EXPECT_EQ(series.frames[0].by, FramePatch::By::kLiftOff);
  EXPECT_NE(series.frames[2].by, FramePatch::By::kLiftOff);
  EXPECT_FALSE(series.frames[2].problem.empty());
  EXPECT_EQ(series.frames[3].by, FramePatch::By::kNothing);
  EXPECT_EQ(series.frames[3].problem, "it was dark");
  PatchSeriesOptions bad;
  bad.sigma_depth_mm = -1;
  EXPECT_THROW(bad.Check(), UsageError);
  bad = {};
  bad.lift_off.power = 1;
  EXPECT_THROW((void)FindPatches({}, ground.axis, Neighbours(ground, 1), bad), UsageError);
}

}  // namespace
}  // namespace plumbline
