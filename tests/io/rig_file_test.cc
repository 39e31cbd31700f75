#include "io/rig_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "calib/error.h"
#include "tests/io/series_fixture.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {
namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::SmallRig;
using testing::TestFolder;

TEST(RigFile, ReadsBackTheSameBits) {
  const fs::path file = TestFolder() / "rig.h5";
  const StereoRig rig = SmallRig();
  WriteRigFile(file, rig);
  const StereoRig back = ReadRigFile(file);
  EXPECT_EQ(back.left.model(), rig.left.model());
  EXPECT_EQ(back.left.size(), rig.left.size());
  EXPECT_EQ(back.left.parameters(), rig.left.parameters());
  EXPECT_EQ(back.right.parameters(), rig.right.parameters());
  EXPECT_EQ(back.right_from_left.Matrix(), rig.right_from_left.Matrix());
  EXPECT_EQ(back.modes.modes, rig.modes.modes);
  EXPECT_TRUE(back.modes.has_scale_mode);
  EXPECT_EQ(back.board, rig.board);
}

TEST(RigFile, HoldsExtrasAndARigWithoutModes) {
  const fs::path file = TestFolder() / "rig.h5";
  StereoRig rig = SmallRig();
  rig.modes = {};
  RigFileExtras extras;
  extras.arrays = {{"residuals", "pixel", "residuals", {2, 2}, {0.5, -1, 2, 3}, {}}};
  extras.texts["verdict"] = "good";
  WriteRigFile(file, rig, extras);
  EXPECT_EQ(ReadRigFile(file).modes.count(), 0);
  const NamedArray array = ReadRigArray(file, "residuals");
  EXPECT_EQ(array.values, extras.arrays[0].values);
  EXPECT_EQ(array.shape, (std::vector<std::size_t>{2, 2}));
  EXPECT_EQ(array.units, "pixel");
  extras.arrays[0].shape = {3};
  EXPECT_THROW(WriteRigFile(file, rig, extras), std::invalid_argument);
  EXPECT_EQ(ReadRigFile(file).modes.count(), 0);  // the good file is untouched
}

TEST(RigFile, MrcalReadsItsCameraModels) {
  const fs::path file = TestFolder() / "rig.h5";
  WriteRigFile(file, SmallRig());
  const auto read = testing::RunPython(R"py(
import sys, io, h5py, mrcal, numpy as np
f = h5py.File(sys.argv[1], 'r')
for side in ('left', 'right'):
    m = mrcal.cameramodel(io.StringIO(f['rig'][side]['cameramodel'].asstr()[()]))
    assert np.array_equal(m.intrinsics()[1], f['rig'][side]['intrinsics'][:])
    assert list(m.imagersize()) == list(f['rig'][side]['image_size'][:])
T = f['rig/right_from_left'][:]
assert np.allclose(m.extrinsics_Rt_fromref()[:3], T[:3, :3], atol=1e-12) and np.allclose(m.extrinsics_Rt_fromref()[3] * 1000, T[:3, 3], atol=1e-9)
print('same')
)py",
                                       file.string());
  EXPECT_THAT(read.output, HasSubstr("same"));
}

TEST(RigFile, SaysWhatIsWrong) {
  const fs::path folder = TestFolder();
  const auto refusal = [&](const char* name) -> std::string {
    try {
      ReadRigFile(folder / name);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  WriteRigFile(folder / "good.h5", SmallRig());
  std::ofstream(folder / "text.h5") << "no HDF5 at all";
  const auto made = testing::RunPython(R"py(
import sys, shutil, h5py, numpy as np
folder = sys.argv[1]
for name in ('motion', 'focal', 'modes', 'model', 'empty'): shutil.copy(folder + '/good.h5', folder + '/' + name + '.h5')
h5py.File(folder + '/motion.h5', 'r+')['rig/right_from_left'][0, 0] = 7
h5py.File(folder + '/focal.h5', 'r+')['rig/left/intrinsics'][0] = np.nan
h5py.File(folder + '/modes.h5', 'r+')['rig/modes'][0, 0] = np.nan
h5py.File(folder + '/model.h5', 'r+')['rig/left'].attrs['lens_model'] = 'LENSMODEL_FISHEYE'
del h5py.File(folder + '/empty.h5', 'r+')['rig']
)py",
                                       folder.string());
  ASSERT_EQ(made.exit_code, 0) << made.output;
  EXPECT_THAT(refusal("none.h5"), HasSubstr("none.h5"));
  EXPECT_THAT(refusal("text.h5"), HasSubstr("text.h5"));
  EXPECT_THAT(refusal("motion.h5"), HasSubstr("no rigid motion"));
  EXPECT_THAT(refusal("focal.h5"), HasSubstr("focal.h5"));
  EXPECT_THAT(refusal("modes.h5"), HasSubstr("modes"));
  EXPECT_THAT(refusal("model.h5"), HasSubstr("FISHEYE"));
  EXPECT_THAT(refusal("empty.h5"), HasSubstr("/rig"));
}

}  // namespace
}  // namespace plumbline
