// The file of a series of one camera: what h5py reads, what Validate() finds, what is exported.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "calib/error.h"
#include "io/export.h"
#include "io/inspect.h"
#include "tests/io/damaged_copies.h"
#include "tests/io/h5py_checks.h"
#include "tests/io/planar_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using testing::BadPlanarFrame;
using testing::ExpectFindings;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::PlanarFrame;
using testing::PlanarHeader;
using testing::TestFolder;
using testing::WritePlanar;

fs::path WriteThreeFrames() {
  const fs::path file = TestFolder() / "run.h5";
  WritePlanar(file, PlanarHeader(), {PlanarFrame(0), BadPlanarFrame(), PlanarFrame(2)});
  return file;
}

TEST(PlanarSeriesFile, RefusesGridsThatAreNotRegular) {
  const fs::path folder = TestFolder();
  WritePlanar(folder / "good.h5", PlanarHeader(), {PlanarFrame(0)});
  const auto made = testing::RunPython(R"py(
import sys, shutil, h5py, numpy as np
folder = sys.argv[1]
def copy(name):
    shutil.copy(folder + '/good.h5', folder + '/' + name)
    return h5py.File(folder + '/' + name, 'r+')
with copy('moved.h5') as f: f['grid/pixel'][2, 3, 1] += 0.5
with copy('nan.h5') as f: f['grid/pixel'][0, 0, 0] = np.nan
with copy('step.h5') as f: f['grid/step_px'][()] = 2**31 - 1
with copy('order.h5') as f: f['grid'].attrs['order'] = 9
with copy('link.h5') as f: f['x'] = h5py.ExternalLink('/etc/passwd', '/')
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  for (const char* name : {"moved", "nan", "step", "order", "link"}) {
    EXPECT_THROW(PlanarSeriesReader(folder / (std::string(name) + ".h5")), InputError) << name;
  }
}

// Every dataset, walked by another reader: units, long_name, an axis on every dimension, fills.
TEST(PlanarSeriesFile, H5pyReadsEveryDatasetWithUnitsAndScales) {
  const fs::path file = WriteThreeFrames();
  testing::WalkWithH5py(file, R"py(
a = f.attrs
assert (a['format'], a['format_version'], a['geometry'], a['default']) == ('plumbline-series', 1, 'planar', 'displacement')
for name in ('created', 'software', 'recipe', 'inputs'): assert name in f.attrs, name
assert count > 40, count
check_nexus('displacement', 'strain', 'grid', 'frames')
u, s = f['displacement/value'], f['displacement/status']
assert u.dtype == 'f8' and u.shape == (3, 5, 7, 2) and u.chunks == (1, 5, 7, 2) and u.shuffle and u.compression_opts == 1
assert u.attrs['units'] == 'pixel' and f['displacement/covariance'].attrs['units'] == 'pixel2'
assert np.isnan(u.fillvalue) and h5py.check_enum_dtype(s.dtype)['low_correlation'] == 4
k = np.arange(35).reshape(5, 7)
ok = k % 5 != 3
for i in (0, 2):
    v = i + .1 * k
    assert np.array_equal(np.isnan(u[i, ..., 0]), ~ok) and np.array_equal(s[i] == 0, ok)
    np.testing.assert_allclose(u[i][ok], np.stack([v, -2 * v], -1)[ok], rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(f['displacement/gradient'][i][ok], np.stack([.01 * v, .02 + 0 * v, .03 + 0 * v, .04 * v], -1)[ok], rtol=1e-6)
    np.testing.assert_allclose(f['displacement/gradient_errors_random'][i][ok], np.broadcast_to([1e-4, 2e-4, 3e-4, 4e-4], (28, 4)), rtol=1e-6)
    np.testing.assert_allclose(f['displacement/value_errors_random'][i][ok][:, 0], 2e-3, rtol=1e-6)
    assert np.array_equal(f['displacement/iterations'][i], 2 + k % 7)
    np.testing.assert_allclose(f['displacement/correlation'][i], .9 + .001 * k, rtol=1e-6)
assert (s[1] == 8).all() and np.isnan(u[1]).all() and (f['displacement/iterations'][1] == 0).all()
assert list(f['displacement/component'].asstr()) == ['u', 'v']
assert list(f['displacement/covariance_component'].asstr()) == ['uu', 'uv', 'vv']
assert list(f['displacement/gradient_component'].asstr()) == ['du/dx', 'du/dy', 'dv/dx', 'dv/dy']
assert f['displacement/gradient_covariance'].shape == (3, 5, 7, 10)
for n in ('displacement/value', 'displacement/gradient', 'strain/value', 'strain/principal', 'strain/angle'):
    assert f[n + '_errors'] == f[n + '_errors_random'] and f[n].shape == f[n + '_errors'].shape, n
for g in ('displacement', 'strain'): assert f[g].attrs['errors_calibration'].startswith('none')
a = f['displacement'].attrs
assert (a['reference'], a['reference_id']) == ('frame 10', 'first.png')
a = f['strain'].attrs
assert (a['measure'], a['strain_axes'], a['vsg_px'], a['window']) == ('hencky', 'image', 65, 5)
E, C, e = f['strain/value'], f['strain/covariance'], f['strain/status'][2]
assert np.array_equal(e == 0, k // 7 != 1) and np.array_equal(np.isnan(E[2, ..., 0]), e != 0)
xx, yy, xy = E[2, 4, 4]
w, V = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
np.testing.assert_allclose(f['strain/principal'][2, 4, 4], w[::-1], rtol=1e-5)
n = V[:, 1]
J = np.array([n[0]**2, n[1]**2, 2 * n[0] * n[1]])
c = C[2, 4, 4]
S = np.array([[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]])
np.testing.assert_allclose(f['strain/principal_errors'][2, 4, 4, 0], np.sqrt(J @ S @ J), rtol=1e-4)
np.testing.assert_allclose(f['strain/value_errors'][2, 4, 4], np.sqrt(np.diag(S)), rtol=1e-6)
g = f['grid']
np.testing.assert_array_equal(g['pixel'][3, 2], [20 + 16, 31 + 24])
a = g.attrs
assert (g['step_px'][()], g['subset_px'][()], a['points'], a['order'], a['subset_shape'], a['interpolation'], a['prefilter_sigma_px']) == (8, 33, 'material', 2, 'circle', 'quintic', .5)
assert list(f['frames/index']) == [10, 11, 12] and list(f['frames/reference_index']) == [-1, -1, 11]
assert list(f['frames/status']) == [0, 1, 0] and f['frames/problem'].asstr()[1] == 'image1.png is truncated'
assert list(f['frames/id'].asstr()) == ['image0.png', 'image1.png', 'image2.png']
c = f['camera']
assert (c['noise_offset'][()], c['noise_slope'][()], c.attrs['noise_source'], c.attrs['bits']) == (2.5, .03, 'static frames', 12)
assert list(c['image_size']) == [640, 480] and 'rig' not in f and 'surface' not in f
print('walked', count)
)py");
}

TEST(PlanarSeriesFile, IsSummedUp) {
  const fs::path file = WriteThreeFrames();
  const FileSummary summary = Inspect(file);
  EXPECT_TRUE(summary.planar);
  EXPECT_EQ(summary.frames, 3);
  EXPECT_EQ(summary.frames_with_surface, 2);
  EXPECT_EQ(summary.points, 56);
  EXPECT_EQ(summary.strain_points, 56);
  EXPECT_EQ(summary.grid_columns, 7);
  EXPECT_THAT(summary.Text(), HasSubstr("3, 2 with a displacement field\n"));
  EXPECT_THAT(summary.Text(), HasSubstr("also holds: gradient_covariance, strain\n"));
  EXPECT_THAT(summary.Text(), Not(HasSubstr("baseline")));
}

TEST(PlanarSeriesFile, IsExportedAsATableWithEveryPoint) {
  const fs::path folder = TestFolder();
  ExportCsv(folder / "all.csv", PlanarFrame(2), CsvPoints::kAll);
  PlanarSeriesFrame frame = PlanarFrame(2);
  frame.strain = {};
  ExportCsv(folder / "ok.csv", frame);
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
t = np.genfromtxt(sys.argv[1] + '/all.csv', delimiter=',', names=True, dtype=None, encoding='utf-8')
k = np.arange(35)
ok = k % 5 != 3
v = 2 + .1 * k
np.testing.assert_array_equal(t['row'] * 7 + t['col'], k)
np.testing.assert_array_equal(t['x_px'], 20 + 8 * (k % 7))
np.testing.assert_array_equal(t['y_px'], 31 + 8 * (k // 7))
np.testing.assert_allclose(t['u_px'], np.where(ok, v, np.nan), rtol=1e-6)
np.testing.assert_allclose(t['v_px'], np.where(ok, -2 * v, np.nan), rtol=1e-6)
np.testing.assert_allclose(t['sigma_u_px'], np.where(ok, 2e-3, np.nan), rtol=1e-6)
np.testing.assert_allclose(t['sigma_v_px'], np.where(ok, np.sqrt(9e-6 + 1e-8 * v), np.nan), rtol=1e-6)
np.testing.assert_allclose(t['zncc'], .9 + .001 * k, rtol=1e-6)
np.testing.assert_array_equal(t['status'], np.where(ok, 'ok', 'low_correlation'))
strained = k // 7 != 1
np.testing.assert_array_equal(t['strain_status'], np.where(strained, 'ok', 'extrapolated'))
np.testing.assert_allclose(t['strain_xy'], np.where(strained, 5e-4 * v, np.nan), rtol=1e-6)
np.testing.assert_allclose(t['sigma_strain_yy'], np.where(strained, 3e-4, np.nan), rtol=1e-6)
t = np.genfromtxt(sys.argv[1] + '/ok.csv', delimiter=',', names=True)
np.testing.assert_array_equal(t['row'] * 7 + t['col'], k[ok])
assert t.dtype.names == ('row', 'col', 'x_px', 'y_px', 'u_px', 'v_px', 'sigma_u_px', 'sigma_v_px', 'zncc')
print('same')
)py",
                                       folder.string());
  EXPECT_THAT(read.output, HasSubstr("same"));
}

TEST(PlanarSeriesFile, ValidateFindsWhatIsMissing) {
  ExpectFindings(
      WriteThreeFrames(),
      {{"del f['displacement/value'].attrs['units']", "/displacement/value has no units"},
       {"f['frames/id'].attrs['long_name'] = ''", "/frames/id has no long_name"},
       {"del f['strain/status'].attrs['DIMENSION_LIST']",
        "dimension 0 of /strain/status has no axis"},
       {"del f['displacement']", "there is no group /displacement"},
       {"del f['camera']", "there is no group /camera"},
       {"del f['camera/noise_slope']", "there is no dataset /camera/noise_slope"},
       {"del f['camera'].attrs['noise_source']", "/camera has no attribute noise_source"},
       {"del f['displacement/covariance']", "there is no dataset /displacement/covariance"},
       {"del f['displacement/value_errors']", "there is no dataset /displacement/value_errors"},
       {"del f['displacement/iterations']", "there is no dataset /displacement/iterations"},
       {"del f['strain/principal']", "there is no dataset /strain/principal"},
       {"del f['frames/reference_index']", "there is no dataset /frames/reference_index"},
       {"del f['grid/row']", "there is no dataset /grid/row"},
       {"del f['grid'].attrs['interpolation']", "/grid has no attribute interpolation"},
       {"del f['displacement'].attrs['reference_id']",
        "/displacement has no attribute reference_id"},
       {"f['displacement'].attrs['reference'] = 'wheel'",
        "the attribute reference of /displacement is \"wheel\", which means nothing"},
       {"f['strain'].attrs['measure'] = 'engineering'",
        "the attribute measure of /strain is \"engineering\", which means nothing"},
       {"del f['strain'].attrs['window']", "/strain has no attribute window"},
       {"f['displacement'].attrs['signal'] = 'depth'", "/displacement names the dataset depth"},
       {"del f.attrs['inputs']", "the file has no attribute inputs"},
       {"f.attrs['format_version'] = 99", "format version 99"},
       {"del f.attrs['geometry']", "there is no group /rig"},
       {"f['grid/pixel'][2, 3, 1] += 0.5", "/grid/pixel is no regular grid"}});
}

TEST(PlanarSeriesFile, ValidateFindsShapesThatDisagree) {
  ExpectFindings(
      WriteThreeFrames(),
      {{"f['displacement/status'].resize(2, axis=0)",
        "/displacement/status holds 2 x 5 x 7, which should be 3 frames x 5 rows x 7 columns"},
       {"del f['displacement/gradient']; f['displacement/gradient'] = np.zeros((3, 5, 7, 3))",
        "/displacement/gradient holds 3 x 5 x 7 x 3, which should be 3 frames x 5 rows x 7 "
        "columns x 4"},
       {"del f['camera/image_size']; f['camera/image_size'] = np.zeros(3, 'i4')",
        "/camera/image_size holds 3, which should be 2"},
       {"del f['frames/time_s']; f['frames/time_s'] = np.zeros(4)",
        "/frames/time_s holds 4, which should be 3 frames"}});
}

TEST(PlanarSeriesFile, ValidateFindsValuesThatTheirStatusDenies) {
  ExpectFindings(
      WriteThreeFrames(),
      {{"f['displacement/value'][2, 0, 3] = 5",
        "frame 2: 1 points have a displacement that their status denies"},
       {"f['displacement/value'][0, 0, :2, 1] = np.nan",
        "frame 0: 2 points have the status ok and no displacement"},
       {"f['displacement/value_errors'][0, 0, 0] = np.inf",
        "frame 0: 1 points have the status ok and no random sigma of the displacement"},
       {"f['displacement/covariance'][2, 0, 0] = np.nan",
        "frame 2: 1 points have the status ok and no covariance"},
       {"f['displacement/gradient'][2, 0, 3] = 1",
        "frame 2: 1 points have a gradient that their status denies"},
       {"f['displacement/status'][0, 0, 3] = 0",
        "frame 0: 1 points have the status ok and no displacement"},
       {"f['displacement/status'][0, 0, 0] = 77", "frame 0: 1 points have an unknown status"},
       {"f['displacement/status'][1, 2, 2] = 0",
        "frame 1: 1 points have the status ok in a frame without a displacement field"},
       {"f['frames/status'][1] = 0",
        "frame 1 holds a displacement field and yet a reason why not: image1.png is truncated"},
       {"f['strain/value'][2, 1, 0] = 5", "frame 2: 1 points have a strain that their status"},
       {"f['strain/value'][2, 0, 0] = np.nan",
        "frame 2: 1 points have the status ok and no strain"},
       {"f['strain/principal_errors'][2, 1, 0] = 5",
        "frame 2: 1 points have a random sigma of the principal strain that their status"},
       {"f['strain/status'][1, 2, 2] = 0",
        "frame 1: 1 points have the status ok in a frame without a displacement field"}});
}

}  // namespace
}  // namespace plumbline
