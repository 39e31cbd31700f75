#include "io/frame_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

TEST(FrameTable, ReadsInPandasFashionWithWhatTheFileHolds) {
  const auto folder = testing::TestFolder();
  {
    SeriesWriter writer(folder / "run.h5", testing::FullHeader());
    writer.Commit(testing::FullFrame(0));
    SeriesFrame bad = testing::FullFrame(1);
    bad = SeriesFrame();
    bad.index = 11;
    bad.time_s = 0.05;
    bad.problem = "it is blurred, and \"dark\"";
    writer.Commit(bad);
    writer.Commit(testing::FullFrame(2));
    writer.Close();
  }
  ExportFrameTable(folder / "run.csv", SeriesReader(folder / "run.h5"));
  const auto read = testing::RunPython(R"py(
import sys, csv, h5py, numpy as np
rows = list(csv.DictReader(open(sys.argv[1] + '/run.csv')))
file = h5py.File(sys.argv[1] + '/run.h5')
print('\n'.join(rows[0].keys()))
assert [row['index'] for row in rows] == ['10', '11', '12']
assert [row['problem'] for row in rows] == ['', 'it is blurred, and "dark"', '']
assert rows[1]['valid_points'] == '0' and rows[0]['valid_points'] == '28'
def same(name, data, scale=1):
    np.testing.assert_allclose([float(row[name]) for row in rows], scale * data, rtol=1e-12)
degrees = 180 / np.pi
for name in ('area_mm2', 'length_mm', 'width_mm'):
    key = name if name in file['patch'] else name.rsplit('_', 1)[0]
    same('patch_' + name, file['patch/' + key][:])
    same('sigma_random_patch_' + name, file['patch/' + key + '_errors_random'][:])
    same('sigma_calibration_patch_' + name, file['patch/' + key + '_errors_calibration'][:])
same('patch_centroid_y_mm', file['patch/centroid'][:, 1])
same('wheel_angle_deg', file['wheel/angle_rad'][:], degrees)
same('sigma_random_wheel_angle_deg', file['wheel/angle_rad_errors_random'][:], degrees)
same('slip_angle_deg', file['slip/angle_rad'][:], degrees)
same('sigma_calibration_slip_ratio', file['slip/ratio_errors_calibration'][:])
same('ground_tilt_y_deg', file['ground/angles_rad'][:, 1], degrees)
# Rz Ry Rx of the turns is the ground's rotation.
def turn(axis, deg):
    c, s = np.cos(deg / degrees), np.sin(deg / degrees)
    R = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    R[a, a], R[a, b], R[b, a], R[b, b] = c, -s, s, c
    return R
for k in (0, 2):
    x, y, z = [float(rows[k]['ground_turn_%s_deg' % axis]) for axis in 'xyz']
    R = turn(2, z) @ turn(1, y) @ turn(0, x)
    np.testing.assert_allclose(R, file['ground/ground_from_rig'][k][:3, :3], atol=1e-12)
assert rows[1]['ground_turn_x_deg'] == 'nan'
same('rig_pitch_deg', file['rig_rotation/pitch_rad'][:], degrees)
same('carcass_twist_deg', file['placement/twist_rad'][:], degrees)
same('placed_by', file['placement/placed_by'][:])
same('sigma_random_radial_mm', file['deformation/radial_mm_errors_random'][:])
same('speed_mm_s', file['slip/speed'][:])
same('translation_z_mm', file['rigid_motion/translation'][:, 2])
print('same')
)py",
                                       folder.string());
  EXPECT_THAT(read.output, HasSubstr("same")) << read.output;
}

TEST(FrameTable, LeavesOutWhatTheSeriesDoesNotHold) {
  const auto folder = testing::TestFolder();
  SeriesWriter writer(folder / "run.h5", testing::SmallHeader());
  writer.Commit(testing::SmallFrame(0));
  writer.Close();
  ExportFrameTable(folder / "run.csv", SeriesReader(folder / "run.h5"));
  std::ifstream in(folder / "run.csv");
  std::string heading, rest;
  std::getline(in, heading);
  EXPECT_THAT(heading, HasSubstr("index,time_s,problem,valid_points,ground_tilt_x_deg"));
  EXPECT_THAT(heading, ::testing::Not(HasSubstr("patch")));
  EXPECT_TRUE(std::getline(in, rest));
  EXPECT_FALSE(std::getline(in, rest));
}

}  // namespace
}  // namespace plumbline
