#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "io/rig_file.h"
#include "io/virtual_rig/virtual_rig.h"
#include "tests/support/shared_data.h"

namespace plumbline::testing {

// What another program makes of the true positions of a frame: python3-mrcal projects them into
// both cameras, to the pixels that the truth says.
inline void ExpectMrcalProjectsTheTruth(const VirtualRig& rig, int frame) {
  const std::filesystem::path folder = TestFolder();
  const auto truth = rig.Truth(frame);
  // A rig file with the relative pose of this very frame: one camera may vibrate.
  StereoRig now = rig.scenario().rig;
  now.right_from_left = truth->right_from_left();
  WriteRigFile(folder / "rig.h5", now);
  std::ofstream out(folder / "points.csv");
  out.precision(17);
  int count = 0;
  for (int y = 0; y < 480; y += 40) {
    for (int x = 0; x < 640; x += 40) {
      const auto point = truth->UnderLeftPixel(Eigen::Vector2d(x, y));
      if (!point) continue;
      ++count;
      const Eigen::Vector3d p = truth->ground_from_rig().Inverse() * point->position_mm;
      out << p.x() << ' ' << p.y() << ' ' << p.z() << ' ' << x << ' ' << y << ' '
          << point->right_px.x() << ' ' << point->right_px.y() << '\n';
    }
  }
  out.close();
  ASSERT_GT(count, 180);
  const auto compared = RunPython(R"py(
import sys, io, h5py, mrcal, numpy as np
folder = sys.argv[1]
table = np.loadtxt(folder + '/points.csv')
f = h5py.File(folder + '/rig.h5')
worst = 0
for side, columns in (('left', slice(3, 5)), ('right', slice(5, 7))):
    model = mrcal.cameramodel(io.StringIO(f['rig'][side]['cameramodel'].asstr()[()]))
    p = mrcal.transform_point_Rt(model.extrinsics_Rt_fromref(), table[:, :3] / 1000)
    q = mrcal.project(p, *model.intrinsics())
    worst = max(worst, np.abs(q - table[:, columns]).max())
assert worst < 1e-6, worst
print('agree')
)py",
                                  folder.string());
  EXPECT_THAT(compared.output, ::testing::HasSubstr("agree"));
}

}  // namespace plumbline::testing
