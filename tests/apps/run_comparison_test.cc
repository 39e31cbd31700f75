#include "apps/run_comparison.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "calib/error.h"
#include "tests/io/series_fixture.h"
#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {

constexpr ImageSize kGrid{41, 31};
constexpr double kStep_mm = 5, kSigma_mm = 0.02;

// A curved surface over the ground, told in the frame of a plane that is off by a height (mm) and
// turns about x and y (rad), and what is claimed for such a plane.
SeriesFrame FrameOff(const Eigen::Vector3d& off = Eigen::Vector3d::Zero(),
                     std::mt19937* random = nullptr) {
  SeriesFrame frame;
  Surface& s = frame.surface;
  s.frame = SurfaceFrame::kGround;
  s.position_mm = Image<Eigen::Vector3f>(kGrid, Eigen::Vector3f::Zero());
  s.sigma_random_mm = Image<Eigen::Vector3f>(
      kGrid, Eigen::Vector3f(0, 0, static_cast<float>(random == nullptr ? 0 : kSigma_mm)));
  s.sigma_calibration_mm = Image<Eigen::Vector3f>(kGrid, Eigen::Vector3f::Constant(NAN));
  s.status = Image<Status>(kGrid, Status::kOk);
  std::normal_distribution<double> normal(0, kSigma_mm);
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      const double x = kStep_mm * (c - 20), y = kStep_mm * (15 - r);
      const double z = 20 + 0.0005 * (x * x + y * y) + off[0] + off[1] * y - off[2] * x +
                       (random == nullptr ? 0 : normal(*random));
      s.position_mm(r, c) = Eigen::Vector3d(x, y, z).cast<float>();
    }
  }
  GroundRecord& g = frame.ground;
  g.found = true;
  g.e1_in_rig = Eigen::Vector3d::UnitX();
  g.e2_in_rig = Eigen::Vector3d::UnitY();
  g.centroid_in_rig_mm.setZero();
  g.cov_random = Eigen::Vector3d(1e-8, 4e-8, 9e-4).asDiagonal();
  return frame;
}

const NeighbourCorrelation kAlone = NeighbourCorrelation::OfOverlap(kGrid, 8, 9, 1);

HeightComparison Compared(const SeriesFrame& run, const SeriesFrame& other,
                          const RunComparisonOptions& options = {}) {
  return CompareFrames(run, kAlone, other, kAlone, options);
}

TEST(RunComparison, FindsHowTheGroundPlanesLieAgainstEachOther) {
  const HeightComparison c = Compared(FrameOff({0.3, 1e-3, -2e-3}), FrameOff());
  EXPECT_NEAR(c.offset_mm, 0.3, 1e-5);
  EXPECT_NEAR(c.tilt_rad[0], 1e-3, 1e-6);
  EXPECT_NEAR(c.tilt_rad[1], -2e-3, 1e-6);
  EXPECT_LT(c.rms_from_plane_mm, 1e-4);
  EXPECT_NEAR(c.difference.mean_mm, 0.3, 1e-4);
  EXPECT_NEAR(c.area_mm2, 200 * 150, 600);
  // Of both planes.
  EXPECT_NEAR(c.sigma_random_tilt_rad[0], std::sqrt(2) * 1e-4, 1e-9);
  EXPECT_NEAR(c.sigma_random_tilt_rad[1], std::sqrt(2) * 2e-4, 1e-9);
  EXPECT_NEAR(c.sigma_random_offset_mm, std::sqrt(2) * 0.03, 1e-9);
  EXPECT_TRUE(std::isnan(c.sigma_calibration_offset_mm));
  EXPECT_TRUE(std::isnan(c.median_sigma_calibration_mm));
}

TEST(RunComparison, ClaimsWhatNoiseMakesOfTheDifference) {
  std::mt19937 random(3);
  const HeightComparison c = Compared(FrameOff(Eigen::Vector3d::Zero(), &random),
                                      FrameOff(Eigen::Vector3d::Zero(), &random));
  double nees = 0;
  int count = 0;
  for (std::size_t i = 0; i < c.difference.value_mm.pixel_count(); ++i) {
    if (!std::isfinite(c.difference.value_mm.data()[i])) continue;
    nees += std::pow(c.difference.value_mm.data()[i] / c.difference.sigma_random_mm.data()[i], 2);
    ++count;
  }
  EXPECT_NEAR(nees / count, 1, 0.15);  // some 1200 independent points
  EXPECT_NEAR(c.within_two_sigma, 0.954, 0.02);
  EXPECT_NEAR(c.rms_from_plane_mm, c.difference.rms_mm, 1e-3);
}

TEST(RunComparison, AFewWrongPointsDoNotTurnThePlane) {
  SeriesFrame wrong = FrameOff({0.3, 1e-3, -2e-3});
  for (int r = 2; r < 6; ++r) {
    for (int c = 2; c < 6; ++c) wrong.surface.position_mm(r, c).z() += 30;
  }
  const HeightComparison c = Compared(wrong, FrameOff());
  EXPECT_GT(c.difference.rms_mm, 3);
  EXPECT_NEAR(c.median_mm, 0.3, 0.1);
  EXPECT_NEAR(c.offset_mm, 0.3, 0.01);
  EXPECT_NEAR(c.tilt_rad[0], 1e-3, 1e-4);
}

TEST(RunComparison, ASectionTellsTheTurnThatShowsInIt) {
  const SeriesFrame off = FrameOff({0.3, 1e-3, -2e-3});
  const HeightComparison along = Compared(off, FrameOff(), {.section = CutPlane::AtY(12)});
  EXPECT_EQ(along.run.grid.size.height, 1);
  EXPECT_NEAR(along.length_mm, 200, 5);
  EXPECT_TRUE(std::isnan(along.area_mm2));
  EXPECT_NEAR(along.difference.mean_mm, 0.3 + 12e-3, 1e-4);
  EXPECT_NEAR(along.tilt_rad[1], -2e-3, 1e-6);
  EXPECT_TRUE(std::isnan(along.tilt_rad[0]));
  const HeightComparison across = Compared(off, FrameOff(), {.section = CutPlane::AtX(-30)});
  EXPECT_NEAR(across.difference.mean_mm, 0.3 - 60e-3, 1e-4);
  EXPECT_NEAR(across.tilt_rad[0], 1e-3, 1e-6);
  // Beside the surface.
  const HeightComparison beside = Compared(off, FrameOff(), {.section = CutPlane::AtX(400)});
  EXPECT_EQ(beside.difference.count, 0);
  EXPECT_TRUE(std::isnan(beside.difference.rms_mm));
  EXPECT_THROW((void)Compared(off, off, {.section = CutPlane::Upright({0, 0}, 0.5)}), UsageError);
  EXPECT_THROW((void)Compared(off, off, {.step_mm = 0, .section = {}}), UsageError);
}

TEST(RunComparison, PairsFramesByTheirNumberInTheRecording) {
  const std::vector<std::int64_t> run = {3, 4, 6}, other = {4, 5, 6, 7};
  const auto pairs = PairByIndex(run, other);
  ASSERT_EQ(pairs.size(), 2U);
  EXPECT_EQ(pairs[0].run, 1);
  EXPECT_EQ(pairs[0].other, 0);
  EXPECT_EQ(pairs[1].run, 2);
  EXPECT_EQ(pairs[1].other, 2);
}

TEST(RunComparison, PairsFramesAtTheSamePlaceOfTheGround) {
  const std::vector<double> run = {0, 28, NAN, 84}, other = {0, 20, 45, 61, 80};
  const auto pairs = PairByTravel(run, other, 35, 8);
  ASSERT_EQ(pairs.size(), 1U);
  EXPECT_EQ(pairs[0].run, 1);
  EXPECT_EQ(pairs[0].other, 3);
  EXPECT_NEAR(pairs[0].ahead_mm, 61 - 35 - 28, 1e-12);
  EXPECT_EQ(PairByTravel(run, other, 35, 10).size(), 2U);  // the first one 10 mm ahead
}

std::string RunOf(const char* name, const SeriesFrame& measured, SurfaceFrame told_in) {
  const auto file = testing::TestFolder() / name;
  SeriesWriter writer(file, testing::SmallHeader(kGrid));
  SeriesFrame frame = testing::SmallFrame(0, kGrid);
  frame.index = 7;
  frame.surface.status = measured.surface.status;
  frame.surface.position_mm = measured.surface.position_mm;
  frame.surface.sigma_random_mm = measured.surface.sigma_random_mm;
  frame.surface.sigma_calibration_mm = measured.surface.sigma_calibration_mm;
  frame.surface.correlation = frame.surface.epipolar_px = Image<float>(kGrid, 0.5F);
  frame.surface.frame = told_in;
  writer.Commit(frame);
  writer.Close();
  return file.string();
}

TEST(RunComparison, IsACommandForTwoFiles) {
  const std::string run = RunOf("run.h5", FrameOff({0.3, 1e-3, -2e-3}), SurfaceFrame::kGround);
  const std::string other = RunOf("other.h5", FrameOff(), SurfaceFrame::kGround);
  const std::string in_rig = RunOf("in_rig.h5", FrameOff(), SurfaceFrame::kRig);
  const auto table = testing::TestFolder() / "differences.csv";
  const auto told =
      testing::RunPlumbline("compare " + run + " " + other + " --json -q -o " + table.string());
  ASSERT_EQ(told.exit_code, 0) << told.output;
  const auto json = nlohmann::json::parse(told.output);
  ASSERT_EQ(json.at("frames").size(), 1U);
  EXPECT_EQ(json["frames"][0].at("index"), 7);
  EXPECT_NEAR(json["frames"][0].at("offset_mm").get<double>(), 0.3, 1e-4);
  EXPECT_TRUE(std::filesystem::exists(table));
  const auto refused = [&](const std::string& arguments, int exit_code, const char* why) {
    const auto result = testing::RunPlumbline("compare " + run + " " + arguments);
    EXPECT_EQ(result.exit_code, exit_code) << result.output;
    EXPECT_THAT(result.output, ::testing::HasSubstr(why));
  };
  refused(in_rig, 3, "not in a ground frame");
  refused(other + " --other-frame 0", 2, "--other-frame goes with --frame");
  refused(other + " --frame 3", 2, "has 1 frames");
  refused(other + " --shift 10", 3, "is not known");  // neither tells its speed
  refused(testing::TestFolder().string() + " --shift 10", 2, "are for two runs");
}

}  // namespace
}  // namespace plumbline
