#include "calib/camera_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "calib/error.h"
#include "calib/internal/mrcal.h"
#include "calib/internal/mrcal_solver.h"
#include "calib/internal/npz.h"
#include "calib/internal/python_literal.h"
#include "tests/support/shared_data.h"
#include "tests/support/synthetic_calibration.h"

namespace plumbline {
namespace {

using testing::RunPython;
using testing::TestFolder;

// A solved calibration with outliers, missing corners and a warp, so that every kind of entry
// counts.
OptimizationInputs SolvedInputs(LensModel::Kind kind = LensModel::Kind::kOpenCv5) {
  testing::SyntheticCalibrationOptions options;
  options.model = kind;
  options.pair_count = 8;
  options.noise_px = 0.1;
  OptimizationInputs inputs = testing::MakeSyntheticCalibration(options);
  inputs.observations_board(11, 2) = -1;
  inputs.calobject_warp = Eigen::Vector2d(0, 0);
  inputs.do_optimize_calobject_warp = true;
  inputs.do_apply_regularization = true;
  EXPECT_TRUE(internal::SolveWithMrcal(inputs).usable());
  return inputs;
}

Rigid3 PoseOfCamera1(const OptimizationInputs& inputs) {
  return Rigid3::FromRotationVector(
      inputs.extrinsics_rt_fromref.row(0).head<3>().transpose(),
      inputs.extrinsics_rt_fromref.row(0).tail<3>().transpose() * 1000);
}

void ExpectSame(const OptimizationInputs& a, const OptimizationInputs& b) {
  EXPECT_EQ(a.lens_model, b.lens_model);
  EXPECT_EQ(a.image_sizes, b.image_sizes);
  EXPECT_EQ(a.intrinsics, b.intrinsics);
  EXPECT_EQ(a.extrinsics_rt_fromref, b.extrinsics_rt_fromref);
  EXPECT_EQ(a.frames_rt_toref, b.frames_rt_toref);
  EXPECT_EQ(a.indices_frame_camintrinsics_camextrinsics,
            b.indices_frame_camintrinsics_camextrinsics);
  EXPECT_EQ(a.observations_board, b.observations_board);
  EXPECT_EQ(a.board_rows, b.board_rows);
  EXPECT_EQ(a.board_columns, b.board_columns);
  EXPECT_EQ(a.calibration_object_spacing, b.calibration_object_spacing);
  EXPECT_EQ(a.calobject_warp, b.calobject_warp);
  EXPECT_EQ(a.do_optimize_calobject_warp, b.do_optimize_calobject_warp);
  EXPECT_EQ(a.do_apply_regularization, b.do_apply_regularization);
  EXPECT_EQ(a.do_apply_outlier_rejection, b.do_apply_outlier_rejection);
}

TEST(CameraModelFile, WhatIsWrittenIsReadBackBitForBit) {
  for (const auto kind : {LensModel::Kind::kOpenCv8, LensModel::Kind::kSplinedStereographic}) {
    const OptimizationInputs inputs = SolvedInputs(kind);
    const Camera camera = inputs.CameraAt(1);
    const Rigid3 pose = PoseOfCamera1(inputs);
    const CameraModelFile read =
        ReadCameraModelText(WriteCameraModelText(camera, pose, &inputs, 1), "text");
    EXPECT_EQ(read.camera.parameters(), camera.parameters());
    EXPECT_EQ(read.camera.model(), camera.model());
    EXPECT_EQ(read.camera.size(), camera.size());
    EXPECT_LT((read.camera_from_reference.Matrix() - pose.Matrix()).norm(), 1e-12);
    EXPECT_EQ(read.camera_index_in_inputs, 1);
    ASSERT_TRUE(read.inputs.has_value());
    ExpectSame(*read.inputs, inputs);
  }
}

TEST(CameraModelFile, TheSameCalibrationGivesTheSameBytes) {
  const OptimizationInputs inputs = SolvedInputs();
  EXPECT_EQ(WriteCameraModelText(inputs.CameraAt(0), {}, &inputs, 0),
            WriteCameraModelText(inputs.CameraAt(0), {}, &inputs, 0));
}

TEST(CameraModelFile, MrcalReadsOursInputsIncludedAndIsAtTheSameOptimum) {
  const OptimizationInputs inputs = SolvedInputs();
  const auto path = TestFolder() / "right.cameramodel";
  WriteCameraModel(path, inputs.CameraAt(1), PoseOfCamera1(inputs), &inputs, 1);
  OptimizationInputs again = inputs;
  const double rms = internal::SolveWithMrcal(again).rms_px;
  const auto result = RunPython(R"(
import sys, numpy as np, mrcal
m = mrcal.cameramodel(sys.argv[1])
i = m.optimization_inputs()
assert m.icam_intrinsics() == 1
assert np.array_equal(m.intrinsics()[1], i['intrinsics'][1])
assert np.allclose(m.extrinsics_rt_fromref(), i['extrinsics_rt_fromref'][0], rtol=0, atol=1e-15)
assert i['points'] is None and i['verbose'] is False and i['do_optimize_calobject_warp'] is True
assert i['indices_frame_camintrinsics_camextrinsics'].dtype == np.int32
assert i['observations_board'].shape == (16, 7, 9, 3)
before = i['intrinsics'].copy()
i['do_apply_outlier_rejection'] = False
mrcal.optimize(**i)
assert np.max(np.abs(i['intrinsics'] - before)) < 1e-4, np.max(np.abs(i['intrinsics'] - before))
x = mrcal.optimizer_callback(**i, no_jacobian=True, no_factorization=True)[1]
n = mrcal.num_measurements_boards(**i)
w = i['observations_board'][...,2]
print(repr(np.sqrt(np.sum(x[:n]**2) / 2 / np.sum(w > 0))))
)",
                                path.string());
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_NEAR(std::stod(result.output), rms, 1e-9);
}

TEST(CameraModelFile, MrcalsToolsAndItsCReaderAcceptOurs) {
  const OptimizationInputs inputs = SolvedInputs();
  const auto path = TestFolder() / "left.cameramodel";
  WriteCameraModel(path, inputs.CameraAt(0), {}, &inputs, 0);
  const auto graft = testing::RunCommand("(/usr/bin/mrcal-graft-models " + path.string() + " " +
                                         path.string() + " 2>/dev/null)");
  EXPECT_EQ(graft.exit_code, 0) << graft.output;
  EXPECT_EQ(ReadCameraModelText(graft.output, "grafted").camera.model().Name(),
            "LENSMODEL_OPENCV5");
  mrcal_cameramodel_t* read = mrcal_read_cameramodel_file(path.c_str());
  ASSERT_NE(read, nullptr);
  EXPECT_EQ(read->lensmodel.type, MRCAL_LENSMODEL_OPENCV5);
  EXPECT_EQ(read->imagersize[1], 480u);
  for (int k = 0; k < 9; ++k) EXPECT_EQ(read->intrinsics[k], inputs.intrinsics(0, k));
  mrcal_free_cameramodel(&read);
}

TEST(CameraModelFile, ReadsMrcalsOwnInputsIncluded) {
  const OptimizationInputs inputs = SolvedInputs();
  const auto ours = TestFolder() / "ours.cameramodel";
  const auto theirs = TestFolder() / "theirs.cameramodel";
  WriteCameraModel(ours, inputs.CameraAt(1), PoseOfCamera1(inputs), &inputs, 1);
  const auto result = RunPython(R"(
import sys, mrcal
i = mrcal.cameramodel(sys.argv[1]).optimization_inputs()
mrcal.cameramodel(optimization_inputs=i, icam_intrinsics=1).write(sys.argv[2], note='a note')
)",
                                ours.string() + " " + theirs.string());
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const CameraModelFile read = ReadCameraModel(theirs);
  // Their text has 10 digits, their inputs all of them.
  EXPECT_LT((read.camera.parameters() - inputs.CameraAt(1).parameters()).norm(), 1e-6);
  EXPECT_LT((read.camera_from_reference.Matrix() - PoseOfCamera1(inputs).Matrix()).norm(), 1e-6);
  ASSERT_TRUE(read.inputs.has_value());
  ExpectSame(*read.inputs, inputs);
}

TEST(CameraModelFile, APairGivesTheRightCameraSeenFromTheLeft) {
  const OptimizationInputs inputs = SolvedInputs();
  const Rigid3 left = Rigid3::FromRotationVector({0.1, 0.2, -0.3}, {5, 6, 7});
  const Rigid3 right_from_left = PoseOfCamera1(inputs);
  WriteCameraModel(TestFolder() / "l.cameramodel", inputs.CameraAt(0), left);
  WriteCameraModel(TestFolder() / "r.cameramodel", inputs.CameraAt(1), right_from_left * left);
  const StereoRig rig =
      ReadCameraModelPair(TestFolder() / "l.cameramodel", TestFolder() / "r.cameramodel");
  EXPECT_LT((rig.right_from_left.Matrix() - right_from_left.Matrix()).norm(), 1e-11);
}

TEST(CameraModelFile, ReadsPythonAsPeopleWriteItAndPinholeAsUndistortedOpenCv) {
  const CameraModelFile read = ReadCameraModelText(
      "# a comment { ' \n{'distortion_model': \"DISTORTION_NONE\" , # another\n"
      "'intrinsics': (1000, 1.001e3, +320.5, 2.4E2,), 'extrinsics': [0,0,0,.1,-0.2,0,],\n"
      "'imagersize': [640,480], 'valid_intrinsics_region': [[0,0],[1,1]], 'x': None}\n",
      "hand");
  EXPECT_EQ(read.camera.model().Name(), "LENSMODEL_OPENCV4");
  EXPECT_EQ(read.camera.parameters()[1], 1001);
  EXPECT_NEAR(read.camera_from_reference.translation_mm.x(), 100, 1e-12);
}

TEST(CameraModelFile, RefusesDamageWithTheFileAndTheReason) {
  const OptimizationInputs inputs = SolvedInputs();
  const std::string good = WriteCameraModelText(inputs.CameraAt(0), {}, &inputs, 0);
  const auto message = [](const std::string& text) -> std::string {
    try {
      ReadCameraModelText(text, "f.cameramodel");
    } catch (const InputError& error) {
      return error.what();
    }
    return "accepted";
  };
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    text.replace(text.find(from), from.size(), to);
    return message(text);
  };
  EXPECT_NE(message("").find("f.cameramodel"), std::string::npos);
  EXPECT_NE(message("{'lensmodel': 'LENSMODEL_OPENCV4'}").find("'intrinsics' is missing"),
            std::string::npos);
  EXPECT_NE(replaced("LENSMODEL_OPENCV5", "LENSMODEL_CAHVOR").find("not supported"),
            std::string::npos);
  EXPECT_NE(replaced("'imagersize': [ 640", "'imagersize': [ 0").find("positive"),
            std::string::npos);
  EXPECT_NE(replaced("'extrinsics': [", "'extrinsics': [ 1,").find("where 6 are needed"),
            std::string::npos);
  EXPECT_NE(replaced("'icam_intrinsics': 0", "'icam_intrinsics': 9").find("icam_intrinsics"),
            std::string::npos);
  // Flipping or cutting anything in the archive is noticed (zip CRC), never misread.
  const std::size_t blob = good.find("optimization_inputs': b'") + 24;
  const std::size_t end = good.find("'", blob);
  for (std::size_t at = blob + 7; at < end; at += (end - blob) / 13) {
    std::string text = good;
    text[at] = text[at] == 'x' ? 'y' : 'x';
    const std::string what = message(text);
    EXPECT_NE(what, "accepted") << at - blob;
    EXPECT_EQ(what.find("f.cameramodel"), 0u) << what;
  }
  std::string cut = good;
  cut.erase(blob + (end - blob) / 2, 100);
  EXPECT_NE(message(cut), "accepted");
  EXPECT_NE(message(std::string(100000, '[')), "accepted");
  EXPECT_THROW(ReadCameraModel("/nowhere/x.cameramodel"), EnvironmentError);
  EXPECT_THROW(WriteCameraModel("/nowhere/x.cameramodel", inputs.CameraAt(0), {}),
               EnvironmentError);
}

TEST(Base85, MatchesPythonForEveryLength) {
  std::string bytes, expected;
  for (int n = 0; n < 40; ++n) {
    EXPECT_EQ(internal::DecodeBase85(internal::EncodeBase85(bytes), "t"), bytes);
    expected += internal::EncodeBase85(bytes) + "\n";
    bytes += static_cast<char>(n * 37 + 200);
  }
  const auto result = RunPython(
      "import base64\nfor n in range(40): "
      "print(base64.b85encode(bytes((k*37+200) % 256 for k in range(n))).decode())");
  EXPECT_EQ(result.output, expected);
  EXPECT_THROW(internal::DecodeBase85("ab\"cd", "t"), InputError);
}

TEST(Npz, ReadsFortranOrderAndSmallTypesAsNumpyMeansThem) {
  const auto path = TestFolder() / "a.npz";
  const auto result = RunPython(R"(
import sys, numpy as np
np.savez(sys.argv[1], f=np.asfortranarray(np.arange(6.).reshape(2,3)), s=np.float32(1.5),
         i=np.arange(3, dtype=np.int16) - 1, b=np.array([True, False]), t='word', e='')
)",
                                path.string());
  ASSERT_EQ(result.exit_code, 0) << result.output;
  std::ifstream in(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  const internal::NpzArchive archive = internal::ReadNpz(bytes, "a.npz");
  using Doubles = std::vector<double>;
  EXPECT_EQ(std::get<Doubles>(archive.at("f").values), (Doubles{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(archive.at("f").shape, (std::vector<std::int64_t>{2, 3}));
  EXPECT_EQ(std::get<Doubles>(archive.at("s").values), Doubles{1.5});
  EXPECT_EQ(std::get<std::vector<std::int64_t>>(archive.at("i").values),
            (std::vector<std::int64_t>{-1, 0, 1}));
  EXPECT_EQ(std::get<std::vector<bool>>(archive.at("b").values), (std::vector<bool>{true, false}));
  EXPECT_EQ(std::get<std::string>(archive.at("t").values), "word");
  EXPECT_EQ(std::get<std::string>(archive.at("e").values), "");
}

}  // namespace
}  // namespace plumbline
