#include "io/wheel_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "calib/error.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/series_fixture.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::SmallRig;
using testing::TestFolder;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Two views of a wheel of 384 mm; the second of three frames was not found.
WheelReference Wheel(int bits) {
  WheelReference wheel{.rig = SmallRig(),
                       .axis = WheelAxis::Through({20, 3, -224}, {0.03, -1, 0.02})};
  wheel.cov_axis_random = 1e-6 * Eigen::Matrix4d::Identity();
  wheel.cov_axis_calibration = 1e-4 * Eigen::Matrix4d::Identity();
  wheel.closed = true;
  wheel.misclosure_rad = 0.001;
  wheel.sigma0 = 0.9;
  wheel.observations = 1000;
  wheel.outliers = 3;
  wheel.frames = {{7, 0.1, WheelFrameStatus::kPlaced, 0, 0, 0, 40},
                  {8, 0.2, WheelFrameStatus::kNotFound, kNone, kNone, kNone, 0},
                  {9, 0.3, WheelFrameStatus::kPlaced, 0.5, 1e-5, 2e-5, 41}};
  wheel.cov_angles_random_rad2 = Eigen::Matrix3d::Zero();
  wheel.cov_angles_random_rad2(2, 2) = 1e-10;
  wheel.cov_axis_angles_random = Eigen::MatrixXd::Zero(4, 3);
  wheel.cov_axis_angles_random(3, 2) = -2e-9;
  const int modes = wheel.rig.modes.count();
  wheel.axis_along_modes = Eigen::MatrixXd::Random(modes, 4);
  wheel.angles_along_modes_rad = Eigen::MatrixXd::Random(modes, 3);
  wheel.profile.y_mm = {-5, 0, 5};
  wheel.profile.radius_mm = {383.9, 384, 383.9};
  wheel.profile.sigma_random_mm = {1e-3, 1e-3, 2e-3};
  wheel.profile.sigma_calibration_mm = {0.1, 0.1, 0.1};
  wheel.profile.scatter_mm = {0.01, 0.01, 0.01};
  wheel.profile.points = {10, 20, 30};
  wheel.profile.crown_radius_mm = 384;
  const ImageSize images = wheel.rig.left.size(), grid{4, 3};
  for (const int frame : {0, 2}) {
    WheelReferenceView view;
    view.frame = frame;
    view.angle_rad = wheel.frames[static_cast<std::size_t>(frame)].angle_rad;
    view.left = view.right = {Image<std::uint16_t>(images, 7), bits};
    view.right.grey(1, 2) = static_cast<std::uint16_t>((1 << bits) - 1 - frame);
    view.first_px = {14, 15};
    view.step_px = 24;
    view.point_mm = Image<Eigen::Vector3d>(grid, Eigen::Vector3d(1, 2, 3.5 + frame));
    view.point_mm(1, 1).setConstant(kNone);
    view.cov_random_mm2 =
        Image<Eigen::Matrix<float, 6, 1>>(grid, Eigen::Matrix<float, 6, 1>::LinSpaced(1.0F, 6.0F));
    view.sigma_calibration_mm = Image<Eigen::Vector3f>(grid, Eigen::Vector3f(0.1F, 0.2F, 0.3F));
    wheel.views.push_back(view);
  }
  return wheel;
}

// Two tags, the second one on the rim.
void AddTags(WheelReference* wheel) {
  wheel->tags.family = "tag36h11";
  wheel->tags.sigma_px = 0.09;
  for (const int id : {3, 11}) {
    WheelTag tag;
    tag.id = id;
    tag.on_rim = id == 11;
    tag.frames = 12 + id;
    for (std::size_t k = 0; k < 4; ++k) tag.corner_mm[k] = Eigen::Vector3d::Random() * 300;
    const WheelTag::Covariance root = WheelTag::Covariance::Random();
    tag.cov_random_mm2 = root * root.transpose();
    tag.along_modes_mm = Eigen::MatrixXd::Random(wheel->rig.modes.count(), 12);
    wheel->tags.tags.push_back(tag);
  }
}

template <typename T>
bool SameBits(const Image<T>& a, const Image<T>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.pixel_count() * sizeof(T)) == 0;
}

TEST(WheelFile, SaysHowLateTheRightCameraWas) {
  const fs::path file = TestFolder() / "wheel.h5";
  WheelReference wheel = Wheel(8);
  WriteWheelFile(file, wheel, "", {});
  EXPECT_FALSE(ReadWheelFile(file).right_delay.has_value());
  EXPECT_EQ(ReadWheelFile(file).delay_mode, -1);
  wheel.right_delay = {2e-5, 1e-6};
  wheel.delay_mode = wheel.rig.modes.count() - 1;
  WriteWheelFile(file, wheel, "", {});
  const WheelReference back = ReadWheelFile(file);
  ASSERT_TRUE(back.right_delay.has_value());
  EXPECT_EQ(back.right_delay->value_s, 2e-5);
  EXPECT_EQ(back.right_delay->sigma_s, 1e-6);
  EXPECT_EQ(back.delay_mode, wheel.delay_mode);
  wheel.right_delay->value_s = 0.1;
  WriteWheelFile(file, wheel, "", {});
  EXPECT_THROW((void)ReadWheelFile(file), InputError);
}

TEST(WheelFile, ReadsBackTheSameBits) {
  for (const int bits : {8, 12}) {
    const fs::path file = TestFolder() / "wheel.h5";
    const WheelReference wheel = Wheel(bits);
    WriteWheelFile(file, wheel, "recipe = 1", {});
    const WheelReference back = ReadWheelFile(file);
    EXPECT_EQ(back.rig.Parameters(), wheel.rig.Parameters());
    EXPECT_EQ(back.axis.rotation, wheel.axis.rotation);
    EXPECT_EQ(back.axis.distance_mm, wheel.axis.distance_mm);
    EXPECT_EQ(back.cov_axis_random, wheel.cov_axis_random);
    EXPECT_EQ(back.cov_axis_calibration, wheel.cov_axis_calibration);
    EXPECT_EQ(back.cov_angles_random_rad2, wheel.cov_angles_random_rad2);
    EXPECT_EQ(back.cov_axis_angles_random, wheel.cov_axis_angles_random);
    EXPECT_EQ(back.axis_along_modes, wheel.axis_along_modes);
    EXPECT_EQ(back.angles_along_modes_rad, wheel.angles_along_modes_rad);
    EXPECT_TRUE(back.closed);
    EXPECT_EQ(back.misclosure_rad, wheel.misclosure_rad);
    EXPECT_EQ(back.sigma0, wheel.sigma0);
    EXPECT_EQ(back.observations, 1000);
    EXPECT_EQ(back.outliers, 3);
    ASSERT_EQ(back.frames.size(), 3U);
    EXPECT_EQ(back.frames[1].status, WheelFrameStatus::kNotFound);
    EXPECT_TRUE(std::isnan(back.frames[1].angle_rad));
    EXPECT_EQ(back.frames[2].index, 9);
    EXPECT_EQ(back.frames[2].time_s, 0.3);
    EXPECT_EQ(back.frames[2].sigma_calibration_rad, 2e-5);
    EXPECT_EQ(back.frames[2].matches, 41);
    EXPECT_EQ(back.profile.radius_mm, wheel.profile.radius_mm);
    EXPECT_EQ(back.profile.points, wheel.profile.points);
    ASSERT_EQ(back.views.size(), 2U);
    for (std::size_t v = 0; v < 2; ++v) {
      const WheelReferenceView &a = wheel.views[v], &b = back.views[v];
      EXPECT_EQ(b.frame, a.frame);
      EXPECT_EQ(b.angle_rad, a.angle_rad);
      EXPECT_EQ(b.left.bits, bits);
      EXPECT_TRUE(SameBits(a.left.grey, b.left.grey));
      EXPECT_TRUE(SameBits(a.right.grey, b.right.grey));
      EXPECT_EQ(b.first_px, a.first_px);
      EXPECT_EQ(b.step_px, a.step_px);
      EXPECT_TRUE(SameBits(a.point_mm, b.point_mm));
      EXPECT_TRUE(SameBits(a.cov_random_mm2, b.cov_random_mm2));
      EXPECT_TRUE(SameBits(a.sigma_calibration_mm, b.sigma_calibration_mm));
    }
  }
}

TEST(WheelFile, HoldsTheTags) {
  const fs::path file = TestFolder() / "wheel.h5";
  WheelReference wheel = Wheel(8);
  WriteWheelFile(file, wheel);
  EXPECT_EQ(ReadWheelFile(file).tags.family, "");  // as files of before have none
  AddTags(&wheel);
  WriteWheelFile(file, wheel);
  const WheelTags back = ReadWheelFile(file).tags;
  EXPECT_EQ(back.family, "tag36h11");
  EXPECT_EQ(back.sigma_px, 0.09);
  ASSERT_EQ(back.tags.size(), 2U);
  for (std::size_t t = 0; t < 2; ++t) {
    const WheelTag &a = wheel.tags.tags[t], &b = back.tags[t];
    EXPECT_EQ(b.id, a.id);
    EXPECT_EQ(b.on_rim, a.on_rim);
    EXPECT_EQ(b.frames, a.frames);
    EXPECT_EQ(b.corner_mm, a.corner_mm);
    EXPECT_EQ(b.cov_random_mm2, a.cov_random_mm2);
    EXPECT_EQ(b.along_modes_mm, a.along_modes_mm);
  }
  const Eigen::Vector3d corner = wheel.tags.tags[1].corner_mm[2];
  testing::WalkWithH5py(file, R"py(
tags = f['wheel/tags']
assert tags.attrs['family'] == 'tag36h11' and tags.attrs['sigma_px'] == 0.09
assert list(tags['id'][:]) == [3, 11] and list(tags['on_rim'][:]) == [0, 1] and list(tags['frames'][:]) == [15, 23]
assert tags['corner'].shape == (2, 4, 3) and tags['corner_covariance'].shape == (2, 12, 12)
assert tags['corner_along_modes'].shape == (2, f['rig/modes'].shape[0], 12)
assert (np.linalg.eigvalsh(tags['corner_covariance'][1]) > -1e-9).all()
print('walked', count)
)py");
  const auto read = testing::RunPython(
      "import sys, h5py; print(float(h5py.File(sys.argv[1])['wheel/tags/corner'][1, 2, 1]))",
      file.string());
  ASSERT_EQ(read.exit_code, 0) << read.output;
  EXPECT_NEAR(std::stod(read.output), corner.y(), 1e-9);
}

TEST(WheelFile, IsReadByH5py) {
  const fs::path file = TestFolder() / "wheel.h5";
  WriteWheelFile(file, Wheel(8));
  testing::WalkWithH5py(file, R"py(
assert f.attrs['format'] == 'plumbline-wheel' and f.attrs['format_version'] == 1
check_nexus('frames', 'profile')
R = f['wheel/rotation'][:]
assert np.allclose(R[:, 1], f['wheel/axis'][:]) and np.allclose(R @ R.T, np.eye(3))
assert f['views/left'].dtype == np.uint8 and f['views/right'][1, 1, 2] == 253
assert f['views/left'].compression == 'gzip'
assert f['views/point'][1, 0, 0, 2] == 5.5 and np.isnan(f['views/point'][0, 1, 1]).all()
names = h5py.check_enum_dtype(f['frames/status'].dtype)
assert f['frames/status'][1] == names['not_found']
assert list(f['frames/index'][:]) == [7, 8, 9]
assert f['views'].attrs['step_px'] == 24
print('walked', count)
)py");
}

TEST(WheelFile, SaysWhatIsWrong) {
  const fs::path folder = TestFolder();
  const auto refusal = [&](const std::string& name) -> std::string {
    try {
      (void)ReadWheelFile(folder / name);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  WheelReference wheel = Wheel(8);
  AddTags(&wheel);
  WriteWheelFile(folder / "good.h5", wheel);
  EXPECT_EQ(refusal("good.h5"), "");
  std::ofstream(folder / "text.h5") << "no HDF5 at all";
  const auto made = testing::RunPython(R"py(
import sys, shutil, h5py, numpy as np
folder = sys.argv[1]
def spoil(name):
    shutil.copy(folder + '/good.h5', folder + '/' + name + '.h5')
    return h5py.File(folder + '/' + name + '.h5', 'r+')
spoil('axis')['wheel/rotation'][0, 0] = np.nan
del spoil('views')['views/left']
spoil('frame')['views/frame'][1] = 3
f = spoil('points'); p = f['views/point'][:, :2]; del f['views/point']; f['views/point'] = p
spoil('rig').attrs['format'] = 'plumbline-rig'
spoil('ids')['wheel/tags/id'][1] = 3
f = spoil('corners'); p = f['wheel/tags/corner'][:, :3]; del f['wheel/tags/corner']; f['wheel/tags/corner'] = p
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_THAT(refusal("none.h5"), ::testing::HasSubstr("plumbline reference"));
  EXPECT_THAT(refusal("text.h5"), ::testing::HasSubstr("text.h5"));
  EXPECT_THAT(refusal("axis.h5"), ::testing::HasSubstr("/wheel/rotation"));
  EXPECT_THAT(refusal("views.h5"), ::testing::HasSubstr("views/left"));
  EXPECT_THAT(refusal("frame.h5"), ::testing::HasSubstr("/views/frame"));
  EXPECT_THAT(refusal("points.h5"), ::testing::HasSubstr("grids"));
  EXPECT_THAT(refusal("ids.h5"), ::testing::HasSubstr("ids do not ascend"));
  EXPECT_THAT(refusal("corners.h5"), ::testing::HasSubstr("/wheel/tags/corner"));
  EXPECT_THAT(refusal("rig.h5"), ::testing::HasSubstr("plumbline-wheel"));
}

}  // namespace
}  // namespace plumbline
