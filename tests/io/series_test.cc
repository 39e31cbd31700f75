#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hdf5.h>
#include <signal.h>
#include <sys/resource.h>

#include <fstream>
#include <random>

#include "calib/error.h"
#include "io/series_reader.h"
#include "io/series_writer.h"
#include "tests/io/damaged_copies.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/series_comparison.h"
#include "tests/io/series_fixture.h"
#include "tests/io/series_processes.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::ExpectSameBits;
using testing::ExpectSameFrame;
using testing::FullFrame;
using testing::FullHeader;
using ::testing::HasSubstr;
using testing::SmallFrame;
using testing::SmallHeader;
using testing::TestFolder;

void WriteSmallSeries(const fs::path& file, int frames, SeriesHeader header = SmallHeader()) {
  SeriesWriter writer(file, header);
  for (int i = 0; i < frames; ++i) writer.Commit(SmallFrame(i));
  writer.Close();
}

TEST(Series, ReadsBackWhatWasWritten) {
  const fs::path file = TestFolder() / "run.h5";
  std::ofstream(TestFolder() / "in.txt") << "abc";
  SeriesHeader header = SmallHeader();
  header.inputs = {TestFolder() / "in.txt"};
  SeriesFrame bad = SmallFrame(1);
  bad.problem = "left1.png is truncated";
  bad.surface = Surface{};
  bad.ground = GroundRecord{};
  bad.ground.problem = "no surface";
  SeriesWriter writer(file, header);
  writer.Commit(SmallFrame(0));
  writer.Commit(bad);
  writer.Commit(SmallFrame(2));
  writer.Close();
  EXPECT_FALSE(fs::exists(file.string() + ".parts"));

  const SeriesReader reader(file);
  ASSERT_EQ(reader.frame_count(), 3);
  ExpectSameFrame(SmallFrame(0), reader.Frame(0));
  ExpectSameFrame(bad, reader.Frame(1));
  EXPECT_TRUE(reader.Frame(1).surface.position_mm.empty());
  ExpectSameFrame(SmallFrame(2), reader.Frame(2));
  EXPECT_THROW(reader.Frame(3), std::out_of_range);
  ExpectSameBits(header.grid_px, reader.grid_px());
  EXPECT_EQ(reader.step_px(), 4);
  EXPECT_EQ(reader.subset_px(), 11);
  EXPECT_EQ(reader.rig().Parameters(), header.rig.Parameters());
  EXPECT_EQ(reader.rig().modes.modes, header.rig.modes.modes);
  EXPECT_EQ(reader.facts().recipe_toml, header.recipe_toml);
  EXPECT_THAT(reader.facts().inputs_json,
              HasSubstr("\"size\": 3, \"sha256\": "
                        "\"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\""));
}

TEST(Series, HoldsLargeFramesCutIntoBands) {
  const fs::path file = TestFolder() / "run.h5";
  const ImageSize grid{700, 401};  // 124 rows a band: the last one is cut
  SeriesHeader header = SmallHeader(grid);
  header.contents.covariance = true;
  SeriesFrame frame = SmallFrame(3, grid);
  frame.surface.cov_random_mm2 =
      Image<Eigen::Matrix<float, 6, 1>>(grid, Eigen::Matrix<float, 6, 1>::Zero());
  for (auto& c : frame.surface.cov_random_mm2.values()) c << 1, 2, 3, 4, 5, 6;
  SeriesWriter writer(file, header);
  writer.Commit(frame);
  writer.Close();
  const SeriesReader reader(file);
  const SeriesFrame back = reader.Frame(0);
  ExpectSameFrame(frame, back);
  EXPECT_EQ(back.surface.cov_random_mm2(400, 699)[5], 6);
  EXPECT_TRUE(std::isnan(back.surface.cov_random_mm2(0, 3)[0]));  // that point is occluded
}

TEST(Series, NeverStoresAValueThatItsStatusDenies) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesFrame frame = SmallFrame(0);
  frame.surface.status(0, 0) = Status::kLowTexture;                              // with a value
  frame.surface.position_mm(0, 1).x() = std::numeric_limits<float>::infinity();  // "ok"
  SeriesWriter writer(file, SmallHeader());
  writer.Commit(frame);
  writer.Close();
  const Surface back = SeriesReader(file).Frame(0).surface;
  EXPECT_TRUE(std::isnan(back.position_mm(0, 0).x()));
  EXPECT_EQ(back.status(0, 1), Status::kFailedVerification);
  EXPECT_TRUE(std::isnan(back.position_mm(0, 1).y()));
}

TEST(Series, AnEmptyRunIsAValidFile) {
  const fs::path file = TestFolder() / "run.h5";
  WriteSmallSeries(file, 0);
  EXPECT_EQ(SeriesReader(file).frame_count(), 0);
}

TEST(Series, RefusesASurfaceOfAnotherSize) {
  SeriesWriter writer(TestFolder() / "run.h5", SmallHeader());
  EXPECT_THROW(writer.Commit(SmallFrame(0, {8, 5})), std::invalid_argument);
  writer.Commit(SmallFrame(0));
  writer.Close();
}

// Run by the test below in a process of its own: commits until it is killed, telling each commit.
TEST(SeriesChild, DISABLED_CommitsUntilKilled) {
  const char* file = std::getenv("PLUMBLINE_SERIES_CHILD");
  if (file == nullptr) GTEST_SKIP() << "a part of Series.AKilledRunLosesNoCommittedFrame";
  SeriesWriter writer(file, FullHeader({70, 50}));
  std::ofstream told(std::string(file) + ".told", std::ios::binary);
  for (int i = 0; i < 100'000; ++i) {
    writer.Commit(FullFrame(i, {70, 50}));
    told << 'x' << std::flush;
  }
}

// The whole point of the journal: a child is killed at any moment, again and again; every frame
// that it had reported as committed is there afterwards.
TEST(Series, AKilledRunLosesNoCommittedFrame) {
  const fs::path folder = TestFolder();
  int with_frames = 0;
  for (int round = 0; round < 8; ++round) {
    const fs::path file = folder / ("run" + std::to_string(round) + ".h5");
    const std::int64_t reported =
        testing::KillWhileCommitting("SeriesChild.DISABLED_CommitsUntilKilled", file, round);
    const RecoveredSeries recovered = RecoverSeries(file);
    EXPECT_GE(recovered.frames, reported);
    EXPECT_LE(recovered.frames, reported + 1);
    const SeriesReader reader(file);
    ASSERT_EQ(reader.frame_count(), recovered.frames);
    EXPECT_EQ(reader.contents(), FullHeader().contents);
    EXPECT_EQ(reader.displacement_reference(), "frame 10");
    EXPECT_EQ(reader.channels().size(), 2u);
    ExpectSameFrame(FullFrame(reported - 1, {70, 50}), reader.Frame(reported - 1));
    with_frames += reported > 2 ? 1 : 0;
    EXPECT_FALSE(fs::exists(file.string() + ".parts"));
  }
  EXPECT_EQ(with_frames, 8);
}

TEST(Series, RecoversUpToTheFirstDamagedByte) {
  const fs::path folder = TestFolder();
  std::mt19937 rng(2);
  for (int round = 0; round < 20; ++round) {
    const fs::path file = folder / ("run" + std::to_string(round) + ".h5");
    {
      SeriesWriter writer(file, FullHeader());
      for (int i = 0; i < 5; ++i) writer.Commit(FullFrame(i));
    }
    testing::DamageOneByte(file.string() + ".parts/journal", rng);
    const RecoveredSeries recovered = RecoverSeries(file);
    EXPECT_LT(recovered.frames, 5);
    EXPECT_GT(recovered.bytes_dropped, 0);
    const SeriesReader reader(file);
    for (std::int64_t i = 0; i < recovered.frames; ++i) {
      ExpectSameFrame(FullFrame(i), reader.Frame(i));
    }
  }
}

TEST(Series, RefusesToOverwriteAnUnfinishedRunOrToRecoverALivingOne) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesWriter writer(file, SmallHeader());
  writer.Commit(SmallFrame(0));
  EXPECT_THROW(SeriesWriter(file, SmallHeader()), InputError);
  EXPECT_THROW(RecoverSeries(file), InputError);
  writer.Close();
  EXPECT_THROW(RecoverSeries(file), InputError);  // nothing left to recover
}

TEST(Series, AFullDiskIsNamedAndKeepsTheCommittedFrames) {
  const fs::path file = TestFolder() / "run.h5";
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  signal(SIGXFSZ, SIG_IGN);
  int committed = 0;
  {
    SeriesWriter writer(file, SmallHeader());
    for (; committed < 3; ++committed) writer.Commit(SmallFrame(committed));
    rlimit small = before;
    small.rlim_cur = fs::file_size(file.string() + ".parts/journal") + 100;
    setrlimit(RLIMIT_FSIZE, &small);
    try {
      writer.Commit(SmallFrame(3));
      ADD_FAILURE() << "wrote beyond the limit";
    } catch (const EnvironmentError& error) {
      EXPECT_THAT(error.what(), HasSubstr("run.h5.parts/journal"));
    }
    small.rlim_cur = 8192;  // no room for the packed file either
    setrlimit(RLIMIT_FSIZE, &small);
    try {
      writer.Close();
      ADD_FAILURE() << "packed beyond the limit";
    } catch (const EnvironmentError& error) {
      EXPECT_THAT(error.what(), HasSubstr("run.h5"));
    }
    setrlimit(RLIMIT_FSIZE, &before);
  }
  EXPECT_EQ(RecoverSeries(file).frames, 3);
  ExpectSameFrame(SmallFrame(2), SeriesReader(file).Frame(2));
}

TEST(Series, AFolderThatCannotBeWrittenIsNamed) {
  try {
    SeriesWriter writer("/nowhere/run.h5", SmallHeader());
    ADD_FAILURE();
  } catch (const EnvironmentError& error) {
    EXPECT_THAT(error.what(), HasSubstr("/nowhere/run.h5"));
  }
}

TEST(Series, RefusesFilesThatReachForOthers) {
  const fs::path folder = TestFolder();
  WriteSmallSeries(folder / "good.h5", 1);
  const auto made = testing::RunPython(R"py(
import sys, shutil, h5py
folder = sys.argv[1]
def copy(name):
    shutil.copy(folder + '/good.h5', folder + '/' + name)
    return h5py.File(folder + '/' + name, 'r+')
with copy('soft.h5') as f: f['x'] = h5py.SoftLink('/rig')
with copy('external_link.h5') as f: f['x'] = h5py.ExternalLink('/etc/passwd', '/')
with copy('external_storage.h5') as f:
    del f['frames/time_s']
    f.create_dataset('frames/time_s', (1,), 'f8', external=[('/etc/passwd', 0, 8)])
with copy('virtual.h5') as f:
    layout = h5py.VirtualLayout((1,), 'f8')
    layout[:] = h5py.VirtualSource('../other.h5', 'x', (1,))
    f.create_virtual_dataset('v', layout)
with copy('huge.h5') as f:
    del f['frames/index']
    f.create_dataset('frames/index', (10**12,), 'i8', chunks=(1000,))
with copy('loop.h5') as f: f['rig/again'] = f['rig']
with copy('other.h5') as f: f.attrs['format'] = 'something'
with copy('newer.h5') as f: f.attrs['format_version'] = 99
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  for (const char* name :
       {"soft", "external_link", "external_storage", "virtual", "huge", "loop", "other", "newer"}) {
    const fs::path file = folder / (std::string(name) + ".h5");
    try {
      SeriesReader reader(file);
      ADD_FAILURE() << name;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(file.string()));
    }
  }
  EXPECT_NO_THROW(SeriesReader(folder / "good.h5"));
}

TEST(Series, SurvivesGarbledAndTruncatedFiles) {
  const fs::path folder = TestFolder();
  {
    SeriesWriter writer(folder / "good.h5", FullHeader());
    for (int i = 0; i < 2; ++i) writer.Commit(FullFrame(i));
    writer.Close();
  }
  testing::ForGarbledCopies(folder / "good.h5", [](const fs::path& file) {
    try {
      const SeriesReader reader(file);
      reader.rig();
      reader.channels();
      for (std::int64_t i = 0; i < std::min<std::int64_t>(reader.frame_count(), 3); ++i) {
        reader.Frame(i);
      }
    } catch (const InputError&) {
    }
  });
}

// Every dataset, walked by another reader: units, long_name, an axis on every dimension, fills.
TEST(Series, H5pyReadsEveryDatasetWithUnitsAndScales) {
  const fs::path file = TestFolder() / "run.h5";
  SeriesHeader header = FullHeader();
  header.rig_extras.arrays = {
      {"board/point_id", "1", "number of the point", {2}, {0, 1}, {}},
      {"board/points", "mm", "target points", {2, 3}, {0, 0, 0, 10, 0, 1}, {"board/point_id"}}};
  SeriesWriter writer(file, header);
  for (int i = 0; i < 3; ++i) writer.Commit(FullFrame(i));
  writer.Close();
  testing::WalkWithH5py(file, R"py(
assert f.attrs['format'] == 'plumbline-series' and f.attrs['format_version'] == 2
for name in ('created', 'software', 'recipe', 'inputs'): assert name in f.attrs, name
assert count > 200, count
check_nexus('surface', 'grid', 'frames', 'ground', 'displacement', 'strain', 'wheel', 'patch', 'slip', 'channels/Fz',
            'match', 'velocity', 'rigid_motion', 'rig_watch', 'rig_rotation', 'deformation', 'material', 'placement')
p, s = f['surface/position'], f['surface/status']
assert p.shape == (3, 5, 7, 3) and p.chunks == (1, 5, 7, 3) and p.shuffle and p.compression_opts == 1
assert np.isnan(p.fillvalue)
assert h5py.check_enum_dtype(s.dtype)['occluded'] == 7
k = np.arange(35).reshape(5, 7)
for i in range(3):
    ok = k % 5 != 3
    assert np.array_equal(np.isnan(p[i, ..., 0]), ~ok) and np.array_equal(s[i] == 0, ok)
    np.testing.assert_allclose(p[i][ok][:, 1], 2 * (i + .1 * k[ok]), rtol=1e-6)
np.testing.assert_allclose(f['surface/position_errors'][:], np.hypot(f['surface/position_errors_random'][:], f['surface/position_errors_calibration'][:]), rtol=1e-6)
for n in ('surface/position', 'displacement/value', 'strain/value', 'strain/principal', 'strain/angle', 'strain/von_mises', 'strain/max_shear',
          'slip/velocity', 'velocity/value', 'rigid_motion/rotation', 'rigid_motion/translation', 'rig_watch/change', 'ground/offset', 'ground/angles_rad',
          'wheel/axis', 'wheel/centre', 'wheel/radius', 'wheel/angle_rad', 'wheel/speed', 'patch/area_mm2', 'patch/length_mm',
          'patch/width_mm', 'patch/centroid', 'slip/ratio', 'slip/angle_rad', 'slip/speed', 'slip/effective_radius_mm', 'slip/ratio_by_channel',
          'rig_rotation/pitch_rad', 'rig_rotation/roll_rad', 'rig_rotation/height_mm', 'deformation/loaded_radius_mm', 'deformation/deflection_mm',
          'placement/twist_rad', 'deformation/longitudinal_mm', 'deformation/lateral_mm', 'deformation/radial_mm'):
    v, a, b, e = (f[n + x][:] for x in ('', '_errors_random', '_errors_calibration', '_errors'))
    assert v.shape == a.shape == b.shape == e.shape, n
    left_out = f[n + '_errors_model'][:] if n == 'strain/value' else 0
    np.testing.assert_allclose(e, np.sqrt(a**2 + b**2 + left_out**2), rtol=1e-6)
    assert np.isfinite(e).any() == (n not in ('wheel/speed', 'strain/angle', 'strain/max_shear', 'slip/ratio_by_channel', 'deformation/deflection_mm')), n
for g in ('surface', 'displacement', 'slip', 'velocity', 'rigid_motion'): assert f[g].attrs['frame'] == 'ground'
assert f['grid'].attrs['points'] == 'material' and f['displacement'].attrs['reference'] == 'frame 10'
assert f['displacement'].attrs['rigid_motion_removed'] == 1
E, a = f['strain/value'], f['strain'].attrs
assert f['strain/green_lagrange'] == E and f['strain/green_lagrange_errors'] == f['strain/value_errors']
assert (a['measure'], a['strain_axes'], a['vsg_px'], a['vsg_mm']) == ('green_lagrange', 'material', 27, 5.5)
assert f['slip'].attrs['convention'] == 'ISO 8855'
assert list(f['strain/component'].asstr()) == ['xx', 'yy', 'xy']
xx, yy, xy = E[2, 4, 4]
w, V = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
np.testing.assert_allclose(f['strain/principal'][2, 4, 4], w[::-1], rtol=1e-5)
angle = f['strain/angle'][2, 4, 4]
np.testing.assert_allclose(f['strain/max_shear'][2, 4, 4], (w[1] - w[0]) / 2, rtol=1e-5)
full = np.diag([*w, -w.sum()])
np.testing.assert_allclose(f['strain/von_mises'][2, 4, 4], np.sqrt(2 / 3 * (full**2).sum()), rtol=1e-5)
ok = s[2] == 0
ok[0, 1] = False
assert np.array_equal(f['strain/status'][2] == 0, ok) and f['strain/status'][2, 0, 1] == 10
for n in ('covariance', 'window_points', 'value_errors_model', 'max_shear', 'von_mises_errors_random', 'principal_errors'):
    v = f['strain/' + n][2].reshape(5, 7, -1)
    assert np.array_equal(np.isfinite(v).all(-1), ok), n
m = f['match']
for n in ('displacement', 'gradient', 'covariance', 'share'):
    for side in ('left_', 'right_'):
        v = m[side + n][2].reshape(5, 7, -1)
        assert v.shape[2] == {'displacement': 2, 'gradient': 4, 'covariance': 3, 'share': 1}[n]
        assert np.array_equal(np.isfinite(v).all(-1), ok), n
assert list(m['gradient_component'].asstr()) == ['du/dx', 'du/dy', 'dv/dx', 'dv/dy']
np.testing.assert_allclose(m['left_gradient'][2][ok], np.stack([[.01, .02 * x, .03, .04] for x in p[2][ok][:, 0]]), rtol=1e-6)
np.testing.assert_allclose(m['right_displacement'][2][ok], .25 * p[2][ok][:, 1:], rtol=1e-6)
r = f['rig_watch']
assert list(r['status']) == [0, 1, 0] and r['refined'][2] == 1 and r['alarm'][0] == 1 and np.isnan(r['alarm'][1])
assert r['change'].shape == (3, 6) and r['right_from_left'].shape == (3, 4, 4) and r.attrs['axes'] == ['frame']
assert list(f['rigid_motion'].attrs['axes']) == ['frame', 'component']
np.testing.assert_allclose(abs(V[:, 1] @ [np.cos(angle), np.sin(angle)]), 1, rtol=1e-6)
assert np.isnan(f['displacement/value'][2, 0, 1]).all() and s[2, 0, 1] == 0
assert f['displacement/value'].chunks == (1, 5, 7, 3) and np.isnan(f['displacement/value'].fillvalue)
first, n = f['patch/contour_first'][:], f['patch/contour_count'][:]
assert list(n) == [3, 0, 5] and list(first) == [0, 3, 3] and f['patch/contour'].shape == (8, 2)
assert list(f['patch/contour_frame']) == [10] * 3 + [12] * 5
np.testing.assert_array_equal(f['patch/contour'][first[2]:first[2] + n[2]], [[2, k] for k in range(5)])
assert list(f['patch/status']) == [0, 1, 0] and f['patch/problem'].asstr()[1] == 'the wheel is in the air'
assert list(f['slip/status']) == [0, 1, 0] and np.isfinite(f['slip/velocity'][1, 0, 0]).all()
assert f['wheel/axis_covariance_random'].shape == (3, 3, 3)
z = f['channels/Fz/value']
assert z.attrs['units'] == 'N' and list(z) == [1, 2, 3, 4] and z.dims[0][0] == f['channels/Fz/time_s']
assert f['ground/ground_from_rig'].shape == (3, 4, 4)
assert f['frames/left_id'].asstr()[2] == 'left2.png'
print('walked', count)
)py");
}

TEST(GroundAngles, SigmasMatchFiniteDifferences) {
  const GroundRecord g = SmallFrame(0).ground;
  const auto angles = [&](const Eigen::VectorXd& ab) -> Eigen::VectorXd {
    GroundRecord turned = g;
    turned.normal_in_rig =
        Rigid3::FromRotationVector(ab[0] * g.e1_in_rig + ab[1] * g.e2_in_rig, {0, 0, 0}) *
        g.normal_in_rig;
    return AnglesOf(turned).angle_rad;
  };
  const Eigen::MatrixXd J = testing::NumericJacobian(angles, Eigen::VectorXd::Zero(2));
  const Eigen::Vector3d expected =
      (J * g.cov_random.topLeftCorner<2, 2>() * J.transpose()).diagonal().cwiseSqrt();
  EXPECT_NEAR((AnglesOf(g).sigma_random_rad - expected).norm(), 0, 1e-9 * expected.norm());
  GroundRecord down = g;
  down.normal_in_rig = Eigen::Vector3d(0, 0, -1);
  EXPECT_NEAR(AnglesOf(down).angle_rad.norm(), 0, 1e-15);
}

}  // namespace
}  // namespace plumbline
