#include "io/section_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "calib/error.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

// z = 10 + 0.1 x + 0.002 y^2 over 10 mm steps, with a hole.
SeriesFrame Roof() {
  const ImageSize grid{21, 17};
  SeriesFrame frame;
  Surface& s = frame.surface;
  s.frame = SurfaceFrame::kGround;
  s.position_mm = Image<Eigen::Vector3f>(grid, Eigen::Vector3f::Zero());
  s.sigma_random_mm = Image<Eigen::Vector3f>(grid, Eigen::Vector3f(0.01F, 0.01F, 0.05F));
  s.sigma_calibration_mm = Image<Eigen::Vector3f>(grid, Eigen::Vector3f(0, 0, 0.2F));
  s.status = Image<Status>(grid, Status::kOk);
  for (int r = 0; r < grid.height; ++r) {
    for (int c = 0; c < grid.width; ++c) {
      const auto x = static_cast<float>(10 * (c - 10)), y = static_cast<float>(10 * (8 - r));
      s.position_mm(r, c) = {x, y, 10 + 0.1F * x + 0.002F * y * y};
    }
  }
  s.position_mm(8, 4).setConstant(std::numeric_limits<float>::quiet_NaN());
  s.status(8, 4) = Status::kLowTexture;
  return frame;
}

TEST(SectionTable, NumpyReadsTheLineWithItsBandAndItsGap) {
  const auto folder = testing::TestFolder();
  const auto neighbours = NeighbourCorrelation::OfOverlap({21, 17}, 8, 9, 1);
  const std::size_t across =
      ExportSection(folder / "x.csv", Roof(), ParseSection("x=25"), neighbours);
  EXPECT_GT(across, 16U);
  (void)ExportSection(folder / "y.csv", Roof(), ParseSection("y=0.5"), neighbours);
  const auto read = testing::RunPython(R"py(
import sys, numpy as np
t = np.genfromtxt(sys.argv[1] + '/x.csv', delimiter=',', names=True)
assert np.isfinite(t['along_mm']).all() and np.allclose(t['x_mm'], 25)
np.testing.assert_allclose(t['along_mm'], t['y_mm'])
np.testing.assert_allclose(t['up_mm'], 12.5 + 0.002 * t['y_mm'] ** 2, atol=0.06)
# A mean of two points that are nearly independent of each other, the slope taking little off.
assert (t['sigma_random_mm'] > 0.03).all() and (t['sigma_random_mm'] < 0.051).all()
assert (abs(t['sigma_calibration_mm'] - 0.2) < 0.02).all()
t = np.genfromtxt(sys.argv[1] + '/y.csv', delimiter=',', names=True)
gap = np.isnan(t['along_mm'])
assert gap.sum() == 1
assert t['along_mm'][np.flatnonzero(gap)[0] - 1] < -60 < t['along_mm'][np.flatnonzero(gap)[0] + 1]
print('same')
)py",
                                       folder.string());
  EXPECT_THAT(read.output, HasSubstr("same")) << read.output;
}

TEST(SectionTable, RefusesWhatIsNoPlane) {
  for (const char* text : {"", "x", "x=", "z=3", "x=1,2", "x=nan", "150"}) {
    EXPECT_THROW((void)ParseSection(text), UsageError) << text;
  }
}

}  // namespace
}  // namespace plumbline
