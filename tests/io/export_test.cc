#include "io/export.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

TEST(Export, VtkReadsThePlyAndNumpyTheCsv) {
  const auto folder = testing::TestFolder();
  ExportPly(folder / "a.ply", testing::SmallFrame(2));
  ExportCsv(folder / "a.csv", testing::SmallFrame(2));
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
from vtkmodules.vtkIOPLY import vtkPLYReader
from vtkmodules.util.numpy_support import vtk_to_numpy
k = np.array([k for k in range(35) if k % 5 != 3])
v = 2 + 0.1 * k
expected = np.stack([v, 2 * v, 3 * v], 1)
reader = vtkPLYReader(); reader.SetFileName(sys.argv[1] + '/a.ply'); reader.Update()
np.testing.assert_allclose(vtk_to_numpy(reader.GetOutput().GetPoints().GetData()), expected, rtol=1e-6)
t = np.genfromtxt(sys.argv[1] + '/a.csv', delimiter=',', names=True)
np.testing.assert_array_equal(t['row'] * 7 + t['col'], k)
np.testing.assert_allclose(t['z_mm'], 3 * v, rtol=1e-6)
np.testing.assert_allclose(t['sigma_calibration_y_mm'], 0.02 * v, rtol=1e-6)
print('same')
)py",
                                       folder.string());
  EXPECT_THAT(read.output, ::testing::HasSubstr("same"));
}

TEST(Export, ACsvOfAllPointsSaysWhyThereIsNoValue) {
  const auto file = testing::TestFolder() / "a.csv";
  ExportCsv(file, testing::SmallFrame(2), CsvPoints::kAll);
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
t = np.genfromtxt(sys.argv[1], delimiter=',', names=True, dtype=None, encoding='utf-8')
k = np.arange(35)
np.testing.assert_array_equal(t['row'] * 7 + t['col'], k)
np.testing.assert_array_equal(t['status'], np.where(k % 5 != 3, 'ok', 'occluded'))
np.testing.assert_allclose(t['x_mm'], np.where(k % 5 != 3, 2 + 0.1 * k, np.nan), rtol=1e-6)
print('same')
)py",
                                       file.string());
  EXPECT_THAT(read.output, ::testing::HasSubstr("same"));
}

TEST(Export, ACsvHoldsDisplacementAndStrainWhereTheFrameDoes) {
  const auto file = testing::TestFolder() / "a.csv";
  const SeriesFrame frame = testing::FullFrame(2);
  ExportCsv(file, frame);
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
t = np.genfromtxt(sys.argv[1], delimiter=',', names=True, dtype=None, encoding='utf-8')
first = t[0]
print(' '.join('%.7g' % first[name] for name in ('u_mm', 'sigma_random_w_mm', 'strain_xy', 'sigma_calibration_strain_yy')), first['strain_status'])
)py",
                                       file.string());
  const auto expected =
      fmt::format("{:.7g} {:.7g} {:.7g} {:.7g} {}", frame.displacement.value_mm(0, 0).x(),
                  frame.displacement.sigma_random_mm(0, 0).z(), frame.strain.value(0, 0).z(),
                  frame.strain.sigma_calibration(0, 0).y(), Name(frame.strain.status(0, 0)));
  EXPECT_THAT(read.output, ::testing::HasSubstr(expected));
}

}  // namespace
}  // namespace plumbline
