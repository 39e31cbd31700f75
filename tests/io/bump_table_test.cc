#include "io/bump_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "calib/error.h"
#include "io/series_points.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

constexpr ImageSize kGrid{41, 33};
constexpr double kStep_mm = 4, kSpeed_mm_s = 1000, kFrame_s = 0.02;

// A wheel over a bump of 6 mm that stands on the ground 40 mm ahead of where it begins. The carcass
// is 20 mm thick in the middle and 22 mm from 50 mm on; the third frame does not tell its speed.
SeriesFrame Over(std::int64_t i) {
  SeriesFrame frame = testing::FullFrame(0, kGrid);
  frame.index = i;
  frame.time_s = kFrame_s * static_cast<double>(i);
  frame.wheel.centre_mm = {0, 3, 370};
  frame.wheel.axis = Eigen::Vector3d::UnitY();
  frame.slip.speed_mm_s = kSpeed_mm_s;
  frame.slip.found = i != 2;
  if (!frame.slip.found) frame.slip.problem = "too little of the contact is seen";
  frame.ground.e1_in_rig = Eigen::Vector3d::UnitX();
  frame.ground.e2_in_rig = Eigen::Vector3d::UnitY();
  frame.ground.centroid_in_rig_mm.setZero();
  frame.ground.ground_from_rig = Rigid3();
  frame.ground.cov_random = Eigen::Vector3d(0, 0, 4e-4).asDiagonal();
  Surface& s = frame.surface;
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      const double x = kStep_mm * (c - 20), y = kStep_mm * (16 - r);
      const double far = std::hypot(x + 20.0 * static_cast<double>(i) - 40, y - 3);
      const double thickness = 20 + 2 * std::min(1.0, std::abs(y - 3) / 50);
      const double z = thickness + 6 * std::exp(-far * far / 200);
      const auto place = static_cast<std::size_t>(r * kGrid.width + c);
      s.status.data()[place] = Status::kOk;
      s.position_mm.data()[place] = Eigen::Vector3d(x, y, z).cast<float>();
      s.sigma_random_mm.data()[place] =
          Eigen::Vector3f(0, 0, static_cast<float>(std::hypot(0.02, 0.01)));
      s.sigma_calibration_mm.data()[place] = Eigen::Vector3f(0, 0, 0.1F);
      s.correlation.data()[place] = s.epipolar_px.data()[place] = 0;
      frame.displacement.value_mm.data()[place] = Eigen::Vector3f(0, 0, 5);
      frame.displacement.sigma_random_mm.data()[place].setConstant(0.01F);
      frame.displacement.sigma_calibration_mm.data()[place].setConstant(0.01F);
    }
  }
  return frame;
}

std::filesystem::path RunOverABump() {
  const auto file = testing::TestFolder() / "run.h5";
  SeriesHeader header = testing::FullHeader(kGrid);
  header.step_px = 8;
  header.subset_px = 9;
  SeriesWriter writer(file, header);
  for (int i = 0; i < 4; ++i) writer.Commit(Over(i));
  writer.Close();
  return file;
}

const CarcassThickness kCarcass{{-100, -50, 0, 50, 100}, {22, 22, 20, 22, 22}};

TEST(BumpTable, ABumpIsWhereItStandsOnTheGroundInEveryFrame) {
  const SeriesReader series(RunOverABump());
  const auto frames = FindBumpsOf(series, kCarcass);
  ASSERT_EQ(frames.size(), 4U);
  for (const FrameBumps& frame : frames) {
    ASSERT_EQ(frame.bumps.size(), 1U) << frame.index;
    const Bump& bump = frame.bumps[0];
    EXPECT_NEAR(bump.at_mm.x(), 40 - 20.0 * static_cast<double>(frame.index), 0.5);
    EXPECT_NEAR(bump.at_mm.y(), 3, 0.5);
    // The mean of the bell over 6 mm.
    EXPECT_NEAR(bump.height_mm.value, 6 * (1 - std::exp(-36.0 / 200)) * 200 / 36, 0.15);
    // What the ground plane's height does to all points is in the clearance and not in the height.
    EXPECT_GT(bump.clearance_mm.sigma_random, 0.02);
    EXPECT_LT(bump.height_mm.sigma_random, 0.01);
    EXPECT_NEAR(bump.clearance_mm.sigma_calibration(), 0.1, 1e-6);
    EXPECT_NEAR(bump.height_mm.sigma_calibration(), 0, 1e-6);
    if (frame.index == 2) continue;  // its speed is not known
    EXPECT_NEAR(frame.travel_mm + bump.at_mm.x(), 40, 0.5);
  }
  EXPECT_TRUE(std::isnan(frames[2].travel_mm));
  const auto table = testing::TestFolder() / "bumps.csv";
  ExportBumps(table, frames);
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
t = np.genfromtxt(sys.argv[1], delimiter=',', names=True)
assert list(t['index']) == [0, 1, 2, 3]
on_ground = (t['travel_mm'] + t['x_mm'])[[0, 1, 3]]
assert np.ptp(on_ground) < 0.1, on_ground
assert (abs(t['height_mm'] - t['clearance_mm']) < 0.05).all()
print('same')
)py",
                                       table.string());
  EXPECT_THAT(read.output, HasSubstr("same")) << read.output;
}

TEST(BumpTable, OneThicknessForAllMakesTheShouldersNoBump) {
  const SeriesReader series(RunOverABump());
  const auto frames = FindBumpsOf(series, {{}, {20}});
  for (const FrameBumps& frame : frames) EXPECT_LE(frame.bumps.size(), 1U);
}

TEST(BumpTable, SaysWhereItDidNotLook) {
  const auto file = testing::TestFolder() / "rig_frame.h5";
  SeriesHeader header = testing::FullHeader(kGrid);
  SeriesWriter writer(file, header);
  SeriesFrame frame = Over(0);
  frame.surface.frame = SurfaceFrame::kRig;
  writer.Commit(frame);
  writer.Close();
  const auto frames = FindBumpsOf(SeriesReader(file), kCarcass);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(frames[0].bumps.empty());
  EXPECT_THAT(frames[0].problem, HasSubstr("not in a ground frame"));
}

TEST(BumpTable, AMapOfTheCarcassNeedsAWheel) {
  const auto file = testing::TestFolder() / "no_wheel.h5";
  SeriesWriter writer(file, testing::SmallHeader());
  writer.Commit(testing::SmallFrame(0));
  writer.Close();
  const SeriesReader series(file);
  EXPECT_THROW((void)FindBumpsOf(series, kCarcass), InputError);
  EXPECT_NO_THROW((void)FindBumpsOf(series, {{}, {20}}));
}

}  // namespace
}  // namespace plumbline
