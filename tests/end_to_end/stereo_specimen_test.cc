// Stereo-DIC on the steel specimen of the Stereo-DIC Challenge, with our own calibration, held
// against DICe's published results.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/support/plumbline_command.h"

namespace plumbline {
namespace {

using testing::CommandResult;
using ::testing::HasSubstr;
using testing::RunPlumbline;
using testing::RunPython;
using testing::TestFolder;
namespace fs = std::filesystem;

// Both shapes are brought together by a rigid motion; then displacements are compared at DICe's
// points (ours between the four points about each). Steps 1 and 5 are frames 1 and 2 of the run.
constexpr const char* kAgainstDice = R"py(
import sys, csv, h5py, numpy as np
f = h5py.File(sys.argv[1])
rows = list(csv.DictReader(open(sys.argv[2])))
grid, position = f['grid/pixel'][:], f['surface/position'][0]
value = f['displacement/value'][:]
variance = f['displacement/value_errors_random'][:]**2 + f['displacement/value_errors_calibration'][:]**2
(x0, y0), step = grid[0, 0], grid[0, 1, 0] - grid[0, 0, 0]
def at(a, x, y):
    c, r = (x - x0) / step, (y - y0) / step
    i, j = int(np.floor(r)), int(np.floor(c))
    if i < 0 or j < 0 or i + 1 >= a.shape[0] or j + 1 >= a.shape[1]: return np.full(3, np.nan)
    u, v = c - j, r - i
    return (1-u)*(1-v)*a[i, j] + u*(1-v)*a[i, j+1] + (1-u)*v*a[i+1, j] + u*v*a[i+1, j+1]
def vectors(row, name): return np.array([float(row[name + c]) for c in 'XYZ'])
first = {r['node']: r for r in rows if r['step'] == '0'}
pixel = {n: (float(r['COORDINATE_X']), float(r['COORDINATE_Y'])) for n, r in first.items()}
nodes = [n for n in first if np.isfinite(at(position, *pixel[n])).all()]
A = np.array([at(position, *pixel[n]) for n in nodes])
B = np.array([vectors(first[n], 'MODEL_COORDINATES_') for n in nodes])
U, S, V = np.linalg.svd((B - B.mean(0)).T @ (A - A.mean(0)))
R = U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V
print('points', len(nodes) > 90)
for frame, dice in ((1, '1'), (2, '5')):
    theirs = {r['node']: vectors(r, 'MODEL_DISPLACEMENT_') for r in rows if r['step'] == dice}
    off = np.array([R @ at(value[frame], *pixel[n]) - theirs[n] for n in nodes])
    ours = np.array([np.diag(R @ np.diag(at(variance[frame], *pixel[n])) @ R.T) for n in nodes])
    combined = np.sqrt(np.nanmedian(ours, 0) + np.nanstd(off, 0)**2)
    print('step', dice, 'off by', np.nanmedian(off, 0), 'of', combined)
    assert np.all(abs(np.nanmedian(off, 0)) < 3 * combined)
print('agrees')
)py";

TEST(StereoSpecimen, ProveAgreementWithDice) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run this";
  PLUMBLINE_SHARED_DATA(specimen, "stereodic-challenge-S3-Dspecimen");
  PLUMBLINE_SHARED_DATA(boards, "stereodic-challenge-S3-Dspecimen-cal");
  const fs::path rig = TestFolder() / "rig.h5", run = TestFolder() / "run.h5";
  fs::remove(rig);
  fs::remove(run);
  const CommandResult calibrated = RunPlumbline(
      "calibrate -q --board donut-dots:14x10:7mm --left '" + (boards / "*_0.jpeg").string() +
      "' --right '" + (boards / "*_1.jpeg").string() + "' -o " + rig.string());
  ASSERT_EQ(calibrated.exit_code, 0) << calibrated.output;
  const CommandResult measured =
      RunPlumbline("measure --matcher dic --frame rig --json -q --rig " + rig.string() +
                   " --left '" + (specimen / "images" / "*_0.png").string() + "' --right '" +
                   (specimen / "images" / "*_1.png").string() + "' --mask " +
                   (specimen / "reference_ALDIC" / "masks" / "Left_0000_0.png").string() + " -o " +
                   run.string() + " 2>/dev/null");
  ASSERT_EQ(measured.exit_code, 0);
  const auto frames = nlohmann::json::parse(measured.output)["frames"];
  ASSERT_EQ(frames.size(), 6U);
  EXPECT_LT(frames[0]["plane"]["rms_mm"].get<double>(), 0.010);
  for (const auto& frame : frames) {
    // What the right camera does not see of the mask is missing.
    EXPECT_GT(frame["valid_points"].get<double>(), 0.965 * frame["grid_points"].get<double>());
  }
  const auto& motion = frames[5]["motion"]["displacement_mm"];
  EXPECT_NEAR(motion[0].get<double>(), 0.094, 0.01);
  EXPECT_NEAR(motion[2].get<double>(), 0.084, 0.01);
  const CommandResult python =
      RunPython(kAgainstDice, run.string() + " " +
                                  (specimen / "reference_DICe" / "DICe_solution_3d.csv").string());
  std::cout << python.output;
  EXPECT_THAT(python.output, HasSubstr("points True"));
  EXPECT_THAT(python.output, HasSubstr("agrees"));
}

}  // namespace
}  // namespace plumbline
