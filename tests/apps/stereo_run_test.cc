#include "apps/stereo_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "tests/apps/stereo_scene.h"

namespace plumbline {
namespace {

using testing::Consistency;
using testing::ConvergentRig;
using ::testing::HasSubstr;
using testing::PairOf;
using testing::SpeckledSheet;

constexpr double kNoise = 1.5;
constexpr double kDegree = M_PI / 180;

StereoRig Rig() { return ConvergentRig({320, 256}, 1500, 400, 140); }

StereoRunOptions Options() {
  StereoRunOptions options;
  options.sequence.field.correlator.subset_px = 25;
  options.sequence.field.correlator.noise = NoiseModel{kNoise * kNoise, 0};
  options.sequence.field.step_px = 10;
  options.evaluation.strain_options.window_points = 7;
  return options;
}

SpeckledSheet TiltedPlane() {
  SpeckledSheet sheet;
  sheet.rig_from_sheet = Rigid3::FromRotationVector({0.1, -0.25, 0.1}, {0, 0, 400});
  return sheet;
}

SpeckledSheet Cylinder() {
  SpeckledSheet sheet = TiltedPlane();
  sheet.rig_from_sheet = Rigid3::FromRotationVector({0.05, -0.1, 0.2}, {0, 0, 395});
  sheet.radius_mm = 100;
  return sheet;
}

// Loaded, and carried along by its machine.
SpeckledSheet Stretched(SpeckledSheet sheet, int frame) {
  const double t = frame;
  sheet.stretch << 1 + 0.004 * t, 0.002 * t, 0, 1 - 0.0012 * t;
  sheet.rig_from_sheet =
      Rigid3::FromRotationVector({0, 0.01 * t, 0}, {0, 0, 0}) * sheet.rig_from_sheet;
  sheet.rig_from_sheet.translation_mm += Eigen::Vector3d(0.3 * t, -0.2 * t, 0.5 * t);
  return sheet;
}

// The right camera turned about an axis of its own, its place kept.
StereoRig Bumped(StereoRig rig, const Eigen::Vector3d& turn_rad) {
  rig.right_from_left =
      Rigid3::FromRotationVector(turn_rad, Eigen::Vector3d::Zero()) * rig.right_from_left;
  return rig;
}

// What the calibration adds where it is known.
Eigen::Vector3f Total(const Eigen::Vector3f& random, const Eigen::Vector3f& calibration) {
  if (!calibration.allFinite()) return random;
  return (random.cwiseAbs2() + calibration.cwiseAbs2()).cwiseSqrt();
}

// How far positions, displacements and strains are off by their sigmas.
struct Errors {
  Consistency position, displacement, strain;
};

Errors ErrorsOf(const StereoRig& rig, const SpeckledSheet& first, const SpeckledSheet& now,
                const Rigid3& frame_from_rig, const Image<Eigen::Vector2f>& grid_px,
                const SeriesFrame& frame, const std::optional<Eigen::Vector3d>& strain_x = {}) {
  Errors errors;
  for (std::size_t i = 0; i < frame.surface.status.pixel_count(); ++i) {
    if (frame.surface.status.data()[i] != Status::kOk) continue;
    const Eigen::Vector2d pixel = grid_px.data()[i].cast<double>();
    const Eigen::Vector2d material = first.MaterialAt(rig, pixel);
    const Eigen::Vector3d before = frame_from_rig * first.PointInRig(material);
    const Eigen::Vector3d after = frame_from_rig * now.PointInRig(material);
    errors.position.AddEach((frame.surface.position_mm.data()[i].cast<double>() - after).eval(),
                            Total(frame.surface.sigma_random_mm.data()[i],
                                  frame.surface.sigma_calibration_mm.data()[i]));
    errors.displacement.AddEach(
        (frame.displacement.value_mm.data()[i].cast<double>() - (after - before)).eval(),
        Total(frame.displacement.sigma_random_mm.data()[i],
              frame.displacement.sigma_calibration_mm.data()[i]));
    if (frame.strain.status.data()[i] != Status::kOk) continue;
    // The next column of the grid, on the surface.
    const Eigen::Vector3d along_columns =
        first.PointInRig(first.MaterialAt(rig, pixel + Eigen::Vector2d(1, 0))) -
        first.PointInRig(first.MaterialAt(rig, pixel - Eigen::Vector2d(1, 0)));
    const Eigen::Vector3d error =
        frame.strain.value.data()[i].cast<double>() -
        TrueStrain(first, now, material, strain_x ? *strain_x : along_columns);
    errors.strain.AddEach(error, Total(frame.strain.sigma_random.data()[i],
                                       frame.strain.sigma_calibration.data()[i]));
  }
  return errors;
}

// The errors of one frame go together; the bounds are wide enough for the few independent ones.
void ExpectWithinSigmas(const Consistency& errors, const char* what) {
  EXPECT_GT(errors.count(), 300) << what;
  EXPECT_GT(errors.nees(), 0.5) << what;
  EXPECT_LT(errors.nees(), 1.6) << what;
  EXPECT_GT(errors.coverage(), 0.88) << what;
}

void ExpectWithinSigmas(const Errors& errors) {
  ExpectWithinSigmas(errors.position, "position");
  ExpectWithinSigmas(errors.displacement, "displacement");
  ExpectWithinSigmas(errors.strain, "strain");
}

TEST(StereoRun, MeasuresAStretchedPlaneInItsGroundFrame) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = TiltedPlane();
  const StereoFrame reference = PairOf(rig, first, kNoise, 1, 0);
  StereoRun run(rig, reference, Options());
  const SeriesHeader header = run.Header();
  const SeriesFrame at_rest = run.Measure(reference, 0).frame;
  ASSERT_TRUE(at_rest.ground.found);
  EXPECT_EQ(at_rest.surface.frame, SurfaceFrame::kGround);
  const Rigid3 ground_from_rig = testing::TrueGroundFromRig(first, rig, header.grid_px, at_rest);
  for (int t = 1; t <= 3; ++t) {
    const SpeckledSheet now = Stretched(first, t);
    const auto number = static_cast<std::uint32_t>(t);
    const StereoRunFrame measured = run.Measure(PairOf(rig, now, kNoise, number + 1, t), t);
    EXPECT_GT(5 * measured.summary.valid_points, 4 * measured.summary.grid_points);
    ExpectWithinSigmas(ErrorsOf(rig, first, now, ground_from_rig, header.grid_px, measured.frame));
    // The plane of this pair, in the rig frame.
    ASSERT_TRUE(measured.frame.ground.found);
    const Eigen::Vector3d off =
        PlaneDifference(testing::PlaneOf(measured.frame.ground), testing::PlaneOf(now));
    for (int k = 0; k < 3; ++k) {
      EXPECT_LT(std::abs(off[k]), 4 * std::sqrt(measured.frame.ground.cov_random(k, k)));
    }
    EXPECT_FALSE(measured.frame.rig_watch.alarm);
  }
}

TEST(StereoRun, MeasuresAStretchedCylinderInTheRigFrame) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = Cylinder();
  StereoRunOptions options = Options();
  options.evaluation.strain_axes = "0.2,1,0";
  const StereoFrame reference = PairOf(rig, first, kNoise, 11, 0);
  StereoRun run(rig, reference, options);
  const SeriesHeader header = run.Header();
  for (int t = 1; t <= 3; ++t) {
    const SpeckledSheet now = Stretched(first, t);
    const auto number = static_cast<std::uint32_t>(t);
    const SeriesFrame frame = run.Measure(PairOf(rig, now, kNoise, number + 11, t), t).frame;
    EXPECT_EQ(frame.surface.frame, SurfaceFrame::kRig);
    ExpectWithinSigmas(
        ErrorsOf(rig, first, now, Rigid3(), header.grid_px, frame, Eigen::Vector3d(0.2, 1, 0)));
  }
}

TEST(StereoRun, TellsStrainAlongTheGroundFrame) {
  const StereoRig rig = Rig();
  SpeckledSheet first = TiltedPlane();
  // Turned in its plane, so that the rig's x axis is neither of the sheet's.
  first.rig_from_sheet = first.rig_from_sheet * Rigid3::FromRotationVector({0, 0, 0.5}, {0, 0, 0});
  StereoRunOptions options = Options();
  options.evaluation.strain_axes = "ground";
  const StereoFrame reference = PairOf(rig, first, kNoise, 21, 0);
  StereoRun run(rig, reference, options);
  const SpeckledSheet now = Stretched(first, 3);
  const SeriesFrame frame = run.Measure(PairOf(rig, now, kNoise, 22, 1), 1).frame;
  const SeriesFrame at_rest = run.Measure(reference, 2).frame;
  ExpectWithinSigmas(ErrorsOf(rig, first, now,
                              testing::TrueGroundFromRig(first, rig, run.Header().grid_px, at_rest),
                              run.Header().grid_px, frame, Eigen::Vector3d::UnitX()));
}

TEST(StereoRun, FindsNoStrainInARigidSpecimenThatTurnsByTenDegreesAndMovesTwentyMillimetres) {
  constexpr double kLittleNoise = 0.3;  // so that the mean is known well enough
  testing::RenderedSpeckleOptions speckle;
  speckle.bits = 12;
  const StereoRig rig = ConvergentRig({400, 320}, 1500, 400, 140);
  StereoRunOptions options = Options();
  options.roi = PixelRegion{75, 60, 250, 200};
  options.sequence.field.correlator.noise = NoiseModel{std::pow(16 * kLittleNoise, 2), 0};
  options.evaluation.strain_options.window_points = 9;
  for (const SpeckledSheet& first : {TiltedPlane(), Cylinder()}) {
    StereoRun run(rig, PairOf(rig, first, kLittleNoise, 31, 0, speckle), options);
    for (int t = 1; t <= 8; ++t) {
      SpeckledSheet now = first;
      const Eigen::Vector3d turn = 10 * kDegree * Eigen::Vector3d(0.3, -0.4, 0.866).normalized();
      const Eigen::Vector3d shift = 20 * Eigen::Vector3d(0.35, -0.3, 0.9).normalized();
      now.rig_from_sheet.rotation =
          RotationFromVector(0.125 * t * turn) * first.rig_from_sheet.rotation;
      now.rig_from_sheet.translation_mm += 0.125 * t * shift;
      const auto number = static_cast<std::uint32_t>(t);
      const SeriesFrame frame =
          run.Measure(PairOf(rig, now, kLittleNoise, 31 + number, t, speckle), t).frame;
      Eigen::Vector3d mean = Eigen::Vector3d::Zero(), sigma = Eigen::Vector3d::Zero();
      double count = 0;
      for (std::size_t i = 0; i < frame.strain.status.pixel_count(); ++i) {
        if (frame.strain.status.data()[i] != Status::kOk) continue;
        mean += frame.strain.value.data()[i].cast<double>();
        sigma += frame.strain.sigma_random.data()[i].cast<double>();
        count += 1;
      }
      ASSERT_GT(count, 150);
      mean /= count;
      sigma /= count;
      // Gauges beside each other are independent, those that overlap are not.
      const double window = options.evaluation.strain_options.window_points;
      const Eigen::Vector3d sigma_mean = sigma * std::min(1.0, window / std::sqrt(count));
      std::printf(
          "rigid, %g of the way: mean strain %+.1f %+.1f %+.1f microstrain, sigma %.1f %.1f %.1f\n",
          0.125 * t, 1e6 * mean[0], 1e6 * mean[1], 1e6 * mean[2], 1e6 * sigma_mean[0],
          1e6 * sigma_mean[1], 1e6 * sigma_mean[2]);
      EXPECT_LT(mean.cwiseAbs().maxCoeff(), 20e-6);
      for (int k = 0; k < 3; ++k) EXPECT_LT(std::abs(mean[k]), 3 * sigma_mean[k]);
    }
  }
}

TEST(StereoRun, TakesARigidMotionOutOfDisplacements) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = TiltedPlane();
  SpeckledSheet now = first;
  now.rig_from_sheet =
      Rigid3::FromRotationVector({0.01, 0.02, -0.03}, {8, 12, -3}) * first.rig_from_sheet;
  StereoRunOptions options = Options();
  options.evaluation.remove_rigid_motion = true;
  StereoRun run(rig, PairOf(rig, first, kNoise, 41, 0), options);
  EXPECT_TRUE(run.Header().rigid_motion_removed);
  const SeriesFrame frame = run.Measure(PairOf(rig, now, kNoise, 42, 1), 1).frame;
  Consistency left;
  for (std::size_t i = 0; i < frame.surface.status.pixel_count(); ++i) {
    if (frame.surface.status.data()[i] != Status::kOk) continue;
    left.AddEach(frame.displacement.value_mm.data()[i],
                 frame.displacement.sigma_random_mm.data()[i]);
  }
  ExpectWithinSigmas(left, "displacement without the rigid motion");
  ASSERT_TRUE(frame.rigid_motion.found);
  EXPECT_NEAR(frame.rigid_motion.rotation_rad.norm(), std::sqrt(14) * 0.01,
              5 * frame.rigid_motion.sigma_random_rotation_rad.maxCoeff());
}

TEST(StereoRun, MarksABadPairAndGoesOn) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = TiltedPlane();
  const StereoFrame reference = PairOf(rig, first, kNoise, 51, 0);
  StereoRun run(rig, reference, Options());
  const auto loaded = [&](int t) {
    return PairOf(rig, Stretched(first, t), kNoise, 51 + static_cast<std::uint32_t>(t), t);
  };
  const StereoRunFrame before = run.Measure(loaded(1), 1);
  StereoFrame damaged;
  damaged.index = 2;
  damaged.problem = "right_2: the file is truncated.";
  const StereoRunFrame bad = run.Measure(damaged, 2);
  EXPECT_EQ(bad.frame.problem, damaged.problem);
  EXPECT_EQ(bad.frame.index, 2);
  EXPECT_EQ(bad.summary.valid_points, 0);
  StereoFrame blank = loaded(3);
  for (GrayImage* image : {&blank.left, &blank.right}) {
    std::fill(image->grey.values().begin(), image->grey.values().end(), std::uint16_t{120});
  }
  const StereoRunFrame dark = run.Measure(blank, 3);
  EXPECT_THAT(dark.frame.problem, HasSubstr("no point"));
  EXPECT_EQ(dark.summary.valid_points, 0);
  const StereoRunFrame after = run.Measure(PairOf(rig, Stretched(first, 1), kNoise, 57, 4), 4);
  EXPECT_TRUE(after.frame.problem.empty());
  EXPECT_NEAR(static_cast<double>(after.summary.valid_points),
              static_cast<double>(before.summary.valid_points), 3);
}

// The one sentence that a rig is refused with.
std::string Refusal(const StereoRig& rig, const StereoFrame& reference) {
  try {
    const StereoRun run(rig, reference, Options());
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(StereoRun, RefusesSwappedCamerasAndTheRigOfOthers) {
  const StereoRig rig = Rig();
  StereoFrame pair = PairOf(rig, TiltedPlane(), kNoise, 61, 0);
  EXPECT_EQ(Refusal(rig, pair), "");
  std::swap(pair.left, pair.right);
  const std::string swapped = Refusal(rig, pair);
  EXPECT_THAT(swapped, HasSubstr("swapped"));
  std::swap(pair.left, pair.right);
  // One that looks down by two degrees more.
  const std::string others = Refusal(Bumped(rig, {2 * kDegree, 0, 0}), pair);
  EXPECT_THAT(others, HasSubstr("the rig file is that of other cameras"));
  for (const std::string& sentence : {swapped, others}) {
    EXPECT_EQ(std::count(sentence.begin(), sentence.end(), '.'), 1) << sentence;
  }
  EXPECT_THAT(Refusal(ConvergentRig({640, 512}, 3000, 400, 140), pair),
              HasSubstr("left_0 is 320x256 px"));
}

struct Bump {
  const char* axis;
  Eigen::Vector3d turn_rad;
  bool strains;  // much more than noise and calibration do
};

class BumpedCamera : public ::testing::TestWithParam<Bump> {};

TEST_P(BumpedCamera, IsNoticedInThatVeryFrameAndItsPoseRefined) {
  const StereoRig rig = testing::WithModes(Rig()), bumped = Bumped(rig, GetParam().turn_rad);
  const SpeckledSheet first = TiltedPlane();
  const StereoFrame reference = PairOf(rig, first, kNoise, 71, 0);
  StereoRunOptions options = Options();
  StereoRun plain(rig, reference, options);
  options.evaluation.refinement = PoseRefinement::kWhenSignificant;
  StereoRun refined(rig, reference, options);
  for (int t = 1; t <= 3; ++t) {
    const SpeckledSheet now = Stretched(first, t);
    const StereoFrame pair =
        PairOf(t < 2 ? rig : bumped, now, kNoise, 71 + static_cast<std::uint32_t>(t), t);
    const SeriesFrame watched = plain.Measure(pair, t).frame;
    const SeriesFrame mended = refined.Measure(pair, t).frame;
    const auto off = [&](const SeriesFrame& frame) {
      return PlaneDifference(testing::PlaneOf(frame.ground), testing::PlaneOf(now));
    };
    const Errors a = ErrorsOf(rig, first, now, Rigid3(), refined.Header().grid_px, watched);
    const Errors b = ErrorsOf(rig, first, now, Rigid3(), refined.Header().grid_px, mended);
    const auto in_sigmas = [&](const SeriesFrame& frame) {
      const Eigen::Matrix3d sum = frame.ground.cov_random + frame.ground.cov_calibration;
      return off(frame).cwiseQuotient(sum.diagonal().cwiseSqrt()).cwiseAbs().maxCoeff();
    };
    std::printf(
        "bumped about %s, pair %d: chi2 %.0f, epipolar rms %.3f px; plane off by %.2g %.2g mrad "
        "%.2g "
        "mm (%.1f sigmas), refined %.1f; strain NEES %.1f, refined %.2f\n",
        GetParam().axis, t, watched.rig_watch.chi2_first, watched.rig_watch.epipolar_rms_px,
        1e3 * off(watched)[0], 1e3 * off(watched)[1], off(watched)[2], in_sigmas(watched),
        in_sigmas(mended), a.strain.nees(), b.strain.nees());
    EXPECT_EQ(watched.rig_watch.alarm, t >= 2);
    EXPECT_EQ(mended.rig_watch.alarm, t >= 2);
    EXPECT_FALSE(watched.rig_watch.refined);
    EXPECT_EQ(mended.rig_watch.refined, t >= 2);
    // With the pose refined, all is within its sigmas, which say how well the matches know it.
    ASSERT_TRUE(mended.ground.found);
    EXPECT_LT(mended.ground.rms_mm, 0.01);
    EXPECT_LT(in_sigmas(mended), 3);
    EXPECT_LT(b.strain.nees(), 4);
    if (t < 2) continue;
    // Without, what the camera's turn does to them is not in the sigmas.
    const Eigen::Vector3d sigma = watched.ground.cov_random.diagonal().cwiseSqrt();
    EXPECT_GT(off(watched).cwiseQuotient(sigma).cwiseAbs().maxCoeff(), 9);
    EXPECT_EQ(a.strain.nees() > 100, GetParam().strains);
  }
}

// About y the epipolar lines nearly keep their place: it is seen by perspective alone, and does
// most harm.
INSTANTIATE_TEST_SUITE_P(About, BumpedCamera,
                         ::testing::Values(Bump{"x", {0.05 * kDegree, 0, 0}, false},
                                           Bump{"y", {0, 0.05 * kDegree, 0}, true},
                                           Bump{"z", {0, 0, 0.05 * kDegree}, false}),
                         [](const auto& info) { return std::string(info.param.axis); });

template <typename T>
bool SameBits(const Image<T>& a, const Image<T>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.pixel_count() * sizeof(T)) == 0;
}

TEST(StereoRun, ComesToTheSameBitsFromTheBeginningOfABlock) {
  const StereoRig rig = Rig();
  const SpeckledSheet first = TiltedPlane();
  StereoRunOptions options = Options();
  options.block_frames = 3;
  std::vector<StereoFrame> pairs;
  for (int t = 0; t < 7; ++t) {
    pairs.push_back(
        PairOf(rig, Stretched(first, t), kNoise, 81 + static_cast<std::uint32_t>(t), t));
  }
  StereoRun whole(rig, pairs[0], options);
  std::vector<SeriesFrame> frames;
  for (std::size_t t = 0; t < pairs.size(); ++t) {
    frames.push_back(whole.Measure(pairs[t], static_cast<std::int64_t>(t)).frame);
  }
  for (const std::int64_t wanted : {3, 5, 6}) {
    StereoRun resumed(rig, pairs[0], options);
    SeriesFrame again;
    const std::int64_t from = resumed.FirstToMeasure(wanted);
    EXPECT_LT(from, wanted);
    EXPECT_GE(from, wanted - 3);
    for (std::int64_t t = from; t <= wanted; ++t) {
      again = resumed.Measure(pairs[static_cast<std::size_t>(t)], t).frame;
    }
    const SeriesFrame& undisturbed = frames[static_cast<std::size_t>(wanted)];
    EXPECT_TRUE(SameBits(again.surface.position_mm, undisturbed.surface.position_mm)) << wanted;
    EXPECT_TRUE(SameBits(again.surface.sigma_random_mm, undisturbed.surface.sigma_random_mm));
    EXPECT_TRUE(SameBits(again.surface.status, undisturbed.surface.status));
    EXPECT_TRUE(SameBits(again.displacement.value_mm, undisturbed.displacement.value_mm));
    EXPECT_TRUE(SameBits(again.velocity.value_mm_s, undisturbed.velocity.value_mm_s));
    EXPECT_TRUE(SameBits(again.strain.value, undisturbed.strain.value));
    EXPECT_TRUE(SameBits(again.strain.sigma_random, undisturbed.strain.sigma_random));
    EXPECT_EQ(again.ground.offset_mm, undisturbed.ground.offset_mm);
    EXPECT_EQ(again.rig_watch.change, undisturbed.rig_watch.change);
  }
}

}  // namespace
}  // namespace plumbline
