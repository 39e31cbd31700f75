// The command on real photographs, as a user runs it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <sstream>

#include "tests/support/plumbline_json.h"

namespace plumbline {
namespace {

using testing::CommandResult;
using ::testing::HasSubstr;
using testing::RunJson;
using testing::RunPlumbline;
using testing::RunPython;
using testing::TestFolder;
namespace fs = std::filesystem;

// --- The steel specimen: flat, at 383.8 mm ------------------------------------------------------

void MeasureSpecimen(const fs::path& specimen, const std::string& rig, const std::string& pair,
                     bool with_calibration) {
  const fs::path run = TestFolder() / ("run" + pair + ".h5");
  const auto json =
      RunJson("measure --rig " + rig + " --left " +
              (specimen / "images" / ("GT4-" + pair + "_0.png")).string() + " --right " +
              (specimen / "images" / ("GT4-" + pair + "_1.png")).string() + " -o " + run.string());
  ASSERT_EQ(json["frames_measured"], 1);
  const auto& plane = json["frames"][0]["plane"];
  std::cout << "pair " << pair << ": " << plane.dump() << std::endl;
  EXPECT_LT(plane["rms_mm"], 0.040);
  EXPECT_GE(plane["points"], 300'000);
  EXPECT_NEAR(plane["mean_distance_mm"], 383.8, 1.0);
  EXPECT_GT(plane["sigma_distance_random_mm"], 0);
  if (with_calibration) {
    EXPECT_GT(plane["sigma_distance_calibration_mm"], 0);
    EXPECT_GT(plane["sigma_tilt_calibration_deg"], 0);
  } else {
    EXPECT_TRUE(plane["sigma_distance_calibration_mm"].is_null());
  }
}

TEST(Measure, FindsTheFlatSpecimenWithAnotherProgramsCalibration) {
  PLUMBLINE_SHARED_DATA(specimen, "stereodic-challenge-S3-Dspecimen");
  const std::string rig = (specimen / "reference_ALDIC" / "calibration_DICe.xml").string();
  MeasureSpecimen(specimen, rig + " --min-distance 350 --max-distance 420", "0000", false);
}

TEST(Measure, ProveFlatSpecimenWithOurOwnCalibration) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run this";
  PLUMBLINE_SHARED_DATA(specimen, "stereodic-challenge-S3-Dspecimen");
  PLUMBLINE_SHARED_DATA(boards, "stereodic-challenge-S3-Dspecimen-cal");
  const fs::path rig = TestFolder() / "rig.h5";
  const auto json =
      RunJson("calibrate --board donut-dots:14x10:7mm --left '" + (boards / "*_0.jpeg").string() +
              "' --right '" + (boards / "*_1.jpeg").string() + "' -o " + rig.string());
  EXPECT_NEAR(json["baseline_mm"], 123.28, 0.05);
  EXPECT_LT(json["joint_rms_px"], 0.065);
  MeasureSpecimen(specimen, rig.string(), "0000", true);
  MeasureSpecimen(specimen, rig.string(), "0129", true);
}

// --- From chessboards to points, and into other programs ----------------------------------------

TEST(Measure, CalibratesFromChessboardsAndMeasuresWithThatRig) {
  PLUMBLINE_SHARED_DATA(boards, "cal-chessboard-opencv-stereo");
  const fs::path folder = TestFolder();
  const std::string rig = (folder / "rig.h5").string();
  const std::string left = (boards / "left*.jpg").string();
  const std::string right = (boards / "right*.jpg").string();
  const auto calibration = RunJson("calibrate --board chessboard:9x6:10mm --left '" + left +
                                   "' --right '" + right + "' -o " + rig + " --seed 3");
  EXPECT_NEAR(calibration["baseline_mm"], 33.325, 0.04);
  EXPECT_EQ(calibration["pairs"].size(), 13U);
  for (const char* file : {"left.cameramodel", "right.cameramodel", "rig.yaml"}) {
    EXPECT_TRUE(fs::exists(folder / file)) << file;
  }

  const std::string run = (folder / "run.h5").string();
  const auto measured = RunJson("measure --rig " + rig + " --left '" + left + "' --right '" +
                                right + "' -o " + run + " --frames 0:1 --step 2");
  EXPECT_EQ(measured["frames_read"], 1);
  EXPECT_EQ(RunPlumbline("validate -q " + run).exit_code, 0);
  const auto info = RunJson("info " + run);
  EXPECT_EQ(info["frames"].size(), 1U);
  EXPECT_THAT(info["recipe"].get<std::string>(), HasSubstr("step = 2"));
  EXPECT_EQ(RunJson("info " + rig)["format"], "plumbline-rig");

  const fs::path ply = folder / "points.ply";
  const auto exported = RunJson("export " + run + " --frame 0 -o " + ply.string());
  const CommandResult python = RunPython(
      "import sys, h5py, numpy as np\n"
      "f = h5py.File(sys.argv[1])\n"
      "assert f.attrs['format'] in ('plumbline-series', b'plumbline-series')\n"
      "p = f['surface/position'][0]\n"
      "ok = np.isfinite(p).all(axis=-1)\n"
      "lines = open(sys.argv[2], 'rb').read().split(b'end_header\\n', 1)\n"
      "n = int([l for l in lines[0].split(b'\\n') if l.startswith(b'element "
      "vertex')][0].split()[2])\n"
      "assert n == ok.sum(), (n, ok.sum())\n"
      "d = np.frombuffer(lines[1], dtype='<f4').reshape(n, -1)\n"
      "assert (d[:, :3] == p[ok]).all()\n"
      "print('read', n)\n",
      run + " " + ply.string());
  EXPECT_EQ(python.exit_code, 0) << python.output;
  EXPECT_THAT(python.output, HasSubstr("read " + exported["files"][0]["points"].dump()));

  // The recipe in the file gives the same run again.
  const fs::path recipe = folder / "again.toml";
  std::ofstream(recipe) << info["recipe"].get<std::string>();
  const std::string again = (folder / "again.h5").string();
  const auto second = RunJson("measure --recipe " + recipe.string() + " -o " + again);
  EXPECT_EQ(second["frames"], measured["frames"]);
}

// --- A video
// --------------------------------------------------------------------------------------

// The sensor files of EuRoC as an OpenCV stereo calibration in metres.
Eigen::Matrix4d ReadSensor(const fs::path& file, std::string& matrix, std::string& distortion) {
  std::stringstream text;
  text << std::ifstream(file).rdbuf();
  const std::string all = text.str();
  const auto numbers = [&](const std::string& key) {
    const std::size_t begin = all.find('[', all.find(key));
    std::string list = all.substr(begin + 1, all.find(']', begin) - begin - 1);
    std::replace(list.begin(), list.end(), ',', ' ');
    std::istringstream words(list);
    std::vector<double> values;
    for (double v; words >> v;) values.push_back(v);
    return values;
  };
  const auto f = numbers("intrinsics:");
  const auto d = numbers("distortion_coefficients:");
  std::ostringstream m, k;
  m << f[0] << ", 0, " << f[2] << ", 0, " << f[1] << ", " << f[3] << ", 0, 0, 1";
  k << d[0] << ", " << d[1] << ", " << d[2] << ", " << d[3];
  matrix = m.str();
  distortion = k.str();
  const auto t = numbers("data:");
  return Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(t.data());
}

std::string WriteEurocRig(const fs::path& data) {
  std::string m1, d1, m2, d2;
  const Eigen::Matrix4d body_from_left = ReadSensor(data / "sensor_left.yaml", m1, d1);
  const Eigen::Matrix4d body_from_right = ReadSensor(data / "sensor_right.yaml", m2, d2);
  const Eigen::Matrix4d right_from_left = body_from_right.inverse() * body_from_left;
  const fs::path file = TestFolder() / "euroc.yaml";
  std::ofstream out(file);
  out.precision(17);
  const auto matrix = [&](const char* name, int rows, int columns, const std::string& values) {
    out << name << ": !!opencv-matrix\n   rows: " << rows << "\n   cols: " << columns
        << "\n   dt: d\n   data: [ " << values << " ]\n";
  };
  std::ostringstream r, t;
  r.precision(17);
  t.precision(17);
  for (int i = 0; i < 9; ++i) r << (i > 0 ? ", " : "") << right_from_left(i / 3, i % 3);
  for (int i = 0; i < 3; ++i) t << (i > 0 ? ", " : "") << right_from_left(i, 3);
  out << "%YAML:1.0\n---\n";
  matrix("M1", 3, 3, m1);
  matrix("D1", 1, 4, d1);
  matrix("M2", 3, 3, m2);
  matrix("D2", 1, 4, d2);
  matrix("R", 3, 3, r.str());
  matrix("T", 3, 1, t.str());
  out << "image_width: 752\nimage_height: 480\n";
  return file.string() + " --rig-length-unit 1000";
}

TEST(Measure, GoesThroughAVideoAndATruncatedCopyOfIt) {
  PLUMBLINE_SHARED_DATA(data, "video-stereo-euroc");
  const std::string rig = WriteEurocRig(data);
  const fs::path run = TestFolder() / "run.h5";
  const std::string common = " --right " + (data / "right.avi").string() +
                             " --step 8 --min-distance 800 --max-distance 20000 -o ";
  const bool prove = std::getenv("PLUMBLINE_PROVE") != nullptr;
  const auto whole = RunJson("measure --rig " + rig + " --left " + (data / "left.avi").string() +
                             common + run.string() + (prove ? "" : " --frames 0:48:24"));
  EXPECT_EQ(whole["frames_measured"], prove ? 48 : 2);

  // 40 % of the file: the container still announces all 48 frames.
  const fs::path cut = TestFolder() / "left.avi";
  fs::copy_file(data / "left.avi", cut);
  fs::resize_file(cut, fs::file_size(cut) * 2 / 5);
  const fs::path half = TestFolder() / "half.h5";
  const CommandResult result = RunPlumbline("measure --rig " + rig + " --left " + cut.string() +
                                            common + half.string() + " --frames ::8");
  EXPECT_EQ(result.exit_code, 0) << result.output;
  std::cout << result.output;
  std::smatch match;
  ASSERT_TRUE(std::regex_search(result.output, match, std::regex("(\\d+) of 6 frames measured")))
      << result.output;
  const int measured = std::stoi(match[1]);
  EXPECT_GE(measured, 2);
  EXPECT_LT(measured, 5);
  EXPECT_EQ(RunPlumbline("validate -q " + half.string()).exit_code, 0);
  EXPECT_EQ(RunJson("info " + half.string())["frames"].size(), static_cast<std::size_t>(measured));
}

// --- Disparity of a rectified pair
// ----------------------------------------------------------------

TEST(DisparityCommand, WritesWhatOtherReadersRead) {
  PLUMBLINE_SHARED_DATA(data, "middlebury-cones-teddy-2003");
  const std::string left = (data / "cones" / "im2.png").string();
  const std::string right = (data / "cones" / "im6.png").string();
  const std::string base = (TestFolder() / "d").string();
  nlohmann::json json;
  for (const char* extension : {".h5", ".png", ".pfm"}) {
    json = RunJson("disparity " + left + " " + right + " -o " + base + extension);
    EXPECT_GT(json["valid_pixels"].get<double>() / json["pixels"].get<double>(), 0.5);
  }
  const CommandResult python = RunPython(
      "import sys, h5py, cv2, numpy as np\n"
      "b = sys.argv[1]\n"
      "f = h5py.File(b + '.h5')['disparity']\n"
      "v = f['value'][()]; s = f['value_errors'][()]; st = f['status'][()]\n"
      "ok = st == 0\n"
      "assert np.isfinite(v[ok]).all() and np.isnan(v[~ok]).all()\n"
      "assert (s[ok] > 0).all() and f['value'].attrs['units']\n"
      "assert f['value'].dims[0][0].name == '/disparity/row'\n"
      "p = cv2.imread(b + '.pfm', cv2.IMREAD_UNCHANGED)\n"
      "assert (p[ok] == v[ok]).all() and np.isinf(p[~ok]).all()\n"
      "g = cv2.imread(b + '.png', cv2.IMREAD_UNCHANGED)\n"
      "assert g.dtype == np.uint16 and (g[~ok] == 0).all()\n"
      "assert np.abs(g[ok] / 256 - v[ok]).max() <= 1 / 512 + 1e-5\n"
      "print('same', ok.sum())\n",
      base);
  EXPECT_EQ(python.exit_code, 0) << python.output;
  EXPECT_THAT(python.output, HasSubstr("same " + json["valid_pixels"].dump()));
}

}  // namespace
}  // namespace plumbline
