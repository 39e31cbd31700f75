#include "apps/internal/rig_watch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "tests/support/rendered_surface.h"
#include "tests/support/seen_matches.h"

namespace plumbline {
namespace {

using internal::RigWatch;

constexpr double kClaimed_px = 0.05;

StereoRig Rig() { return testing::ConvergentRig({640, 512}, 1500, 400, 140); }

StereoRig Bumped(StereoRig rig) {
  rig.right_from_left =
      Rigid3::FromRotationVector({1e-3, 0, 0}, Eigen::Vector3d::Zero()) * rig.right_from_left;
  return rig;
}

// Matches whose noise is `times` what they claim.
std::vector<StereoObservation> See(const StereoRig& rig, double times, std::uint32_t seed) {
  return testing::SeeCurvedSurface(rig, kClaimed_px, times * kClaimed_px, seed);
}

// Chi-squared has a mean of 5 whatever the matches claim, the reference pair's and the later ones'.
TEST(RigWatch, JudgesAllPairsByWhatTheirMatchesScatter) {
  constexpr int kDraws = 100;
  for (const double times : {1.0, 4.0}) {
    double reference = 0, later = 0;
    for (std::uint32_t i = 0; i < kDraws; ++i) {
      RigWatch watch(Rig(), {});
      const RigWatchRecord first = watch.Reference(See(Rig(), times, 2 * i)).record;
      const RigWatchRecord second = watch.Later(See(Rig(), times, 2 * i + 1)).record;
      EXPECT_FALSE(first.alarm);
      EXPECT_FALSE(second.alarm);
      reference += first.chi2_calibration / kDraws;
      later += second.chi2_first / kDraws;
    }
    const double tolerance = 4 * std::sqrt(10.0 / kDraws);
    EXPECT_NEAR(reference, 5, tolerance) << times;
    EXPECT_NEAR(later, 5, tolerance) << times;
  }
}

TEST(RigWatch, GivesAnAlarmWhereTheCameraHasMoved) {
  for (const double times : {1.0, 4.0}) {
    RigWatch since_calibration(Rig(), {}), since_reference(Rig(), {});
    EXPECT_TRUE(since_calibration.Reference(See(Bumped(Rig()), times, 1)).record.alarm);
    EXPECT_FALSE(since_calibration.Later(See(Bumped(Rig()), times, 2)).record.alarm);
    EXPECT_FALSE(since_reference.Reference(See(Rig(), times, 3)).record.alarm);
    EXPECT_TRUE(since_reference.Later(See(Bumped(Rig()), times, 4)).record.alarm);
  }
}

TEST(RigWatch, TellsTheDistancesFromTheEpipolarLinesOfTheCalibratedPose) {
  RigWatch watch(Rig(), {});
  std::vector<StereoObservation> seen = See(Bumped(Rig()), 1, 5);
  seen[30].right.y() += 20;  // a mismatch
  const RigWatchRecord record = watch.Reference(seen).record;
  double sum = 0, squares = 0, expected = 0, count = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (i == 30) continue;
    const TriangulatedPoint point = Triangulate(Rig(), seen[i]);
    sum += point.epipolar_px;
    squares += point.epipolar_px * point.epipolar_px;
    expected += point.sigma_epipolar_px * point.sigma_epipolar_px;
    count += 1;
  }
  EXPECT_GT(std::abs(sum / count), 1);
  EXPECT_NEAR(record.epipolar_mean_px, sum / count, 1e-3);
  EXPECT_NEAR(record.epipolar_rms_px, std::sqrt(squares / count), 1e-3);
  EXPECT_NEAR(record.epipolar_sigma_px, std::sqrt(expected / count), 1e-3);
}

}  // namespace
}  // namespace plumbline
