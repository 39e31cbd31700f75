#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <numbers>

#include "calib/camera_file.h"
#include "calib/error.h"
#include "calib/triangulate.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using testing::RunPython;
using testing::TestFolder;

double AngleDegrees(const StereoRig& rig) {
  return rig.right_from_left.RotationVector().norm() * 180 / std::numbers::pi;
}

std::filesystem::path Write(const std::string& name, const std::string& text) {
  const auto path = TestFolder() / name;
  std::ofstream(path) << text;
  return path;
}

// The message of the refusal; empty if the file was accepted.
std::string Refusal(const std::filesystem::path& path,
                    const ForeignCalibrationOptions& options = {}) {
  try {
    ReadStereoCalibrationFile(path, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

StereoRig TestRig(const char* model) {
  const LensModel lens = LensModel::FromName(model);
  const double left[] = {1234.5, 1230.25, 640.1, 480.2, -0.2, 0.1,
                         1e-3,   -2e-3,   0.05,  0.01,  0.02, 0.03};
  Eigen::VectorXd l = Eigen::Map<const Eigen::VectorXd>(left, lens.ParameterCount());
  Eigen::VectorXd r = l;
  r[0] += 7, r[2] -= 3, r[4] = -0.19;
  return {Camera(lens, {1280, 960}, l),
          Camera(lens, {1280, 960}, r),
          Rigid3::FromRotationVector({0.02, -0.3, 0.01}, {-100.123, 1.5, 12.25}),
          {},
          ""};
}

TEST(OpenCvYaml, Cv2ReadsOursAndProjectsAlikeAndWeReadItBack) {
  for (const char* model : {"opencv4", "opencv5", "opencv8"}) {
    const StereoRig rig = TestRig(model);
    const auto path = TestFolder() / "rig.yml";
    WriteOpenCvYaml(rig, path);
    const StereoCalibrationFile read = ReadStereoCalibrationFile(path);
    EXPECT_EQ(read.format, "OpenCV");
    EXPECT_EQ(read.rig.left.parameters(), rig.left.parameters());
    EXPECT_EQ(read.rig.right.parameters(), rig.right.parameters());
    EXPECT_EQ(read.rig.left.size(), rig.left.size());
    EXPECT_LT((read.rig.right_from_left.Matrix() - rig.right_from_left.Matrix()).norm(), 1e-12);
    const auto result = RunPython(R"(
import sys, cv2, numpy as np
f = cv2.FileStorage(sys.argv[1], cv2.FILE_STORAGE_READ)
m = {k: f.getNode(k).mat() for k in ('M1', 'D1', 'M2', 'D2', 'R', 'T')}
assert int(f.getNode('image_width').real()) == 1280 and int(f.getNode('image_height').real()) == 960
q, _ = cv2.projectPoints(np.array([[[30., -40., 500.]]]), cv2.Rodrigues(m['R'])[0], m['T'], m['M2'], m['D2'])
print(repr(float(q[0,0,0])), repr(float(q[0,0,1])))
)",
                                  path.string());
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const Eigen::Vector2d expected =
        rig.right.Project(rig.right_from_left * Eigen::Vector3d(30, -40, 500));
    std::istringstream numbers(result.output);
    double x = 0, y = 0;
    numbers >> x >> y;
    EXPECT_NEAR((Eigen::Vector2d(x, y) - expected).norm(), 0, 1e-8);
  }
}

TEST(StereoCalibration, ReadsWhatCv2WritesAsYamlXmlAndJson) {
  for (const char* extension : {"yml", "xml", "json"}) {
    const auto path = TestFolder() / (std::string("cal.") + extension);
    const auto result = RunPython(R"(
import sys, cv2, numpy as np
f = cv2.FileStorage(sys.argv[1], cv2.FILE_STORAGE_WRITE)
K = np.array([[500., 0, 320], [0, 501, 240], [0, 0, 1]])
f.write('image_width', 640); f.write('image_height', 480)
for c in '12':
    f.write('cameraMatrix' + c, K); f.write('distCoeffs' + c, np.array([[.1], [-.2], [.001], [.002], [.3]]))
f.write('R', cv2.Rodrigues(np.array([0, .1, 0]))[0]); f.write('T', np.array([[-.06], [0], [.001]])); f.release()
)",
                                  path.string());
    ASSERT_EQ(result.exit_code, 0) << result.output;
    ForeignCalibrationOptions metres;
    metres.length_unit_mm = 1000;
    const StereoRig rig = ReadStereoCalibration(path, metres);
    EXPECT_EQ(rig.left.model().Name(), "LENSMODEL_OPENCV5");
    EXPECT_EQ(rig.right.parameters()[8], 0.3);
    EXPECT_NEAR(rig.right_from_left.translation_mm.x(), -60, 1e-9);
    EXPECT_NEAR(rig.right_from_left.RotationVector().y(), 0.1, 1e-12);
  }
}

constexpr const char* kMatrix =
    "{rows: 3, cols: 3, data: [500., 0., 320., 0., 500., 240., 0., 0., 1.]}";

std::string Yaml(const std::string& d1, const std::string& rest) {
  return "%YAML:1.0\n---\nM1: " + std::string(kMatrix) + "\nM2: " + kMatrix + "\nD1: " + d1 +
         "\nD2: [0., 0., 0., 0.]\n" + rest;
}
constexpr const char* kPose = "R: [0., 0.2, 0.]\nT: [-100., 0., 0.]\n";
constexpr const char* kSize = "image_width: 640\nimage_height: 480\n";

TEST(StereoCalibration, MissingOpenCvKeysAreRefusedNotReadAsZero) {
  const std::string pose = kPose, size = kSize, d = "[0.1, 0., 0., 0.]";
  EXPECT_EQ(Refusal(Write("good.yml", Yaml(d, pose + size))), "");
  EXPECT_NE(Refusal(Write("a.yml", Yaml(d, size))).find("no R and T"), std::string::npos);
  EXPECT_NE(Refusal(Write("b.yml", Yaml(d, pose))).find("--image-size"), std::string::npos);
  EXPECT_EQ(Refusal(Write("b.yml", Yaml(d, pose)), {ImageSize{640, 480}, 1}), "");
  EXPECT_NE(Refusal(Write("c.yml", Yaml(d, pose + size)), {ImageSize{641, 480}, 1}).find("640x480"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("d.yml", Yaml(d, pose + "image_width: 640\n"))).find("image_height"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("e.yml", Yaml("[0.1, 0.]", pose + size))).find("2 coefficients"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("f.yml", Yaml("[0.1, .nan, 0., 0.]", pose + size))).find("'D1'"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("g.yml", Yaml("[0.1, abc, 0., 0.]", pose + size))).find("'D1'"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("h.yml", "%YAML:1.0\n---\nx: 1\n")).find("camera_matrix"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("i.yml", "")).find("empty"), std::string::npos);
  EXPECT_NE(Refusal(Write("j.yml", Yaml(d, "R: [0., 0.2, 0.]\nT: [0., 0., 0.]\n" + size)))
                .find("same place"),
            std::string::npos);
  EXPECT_NE(
      Refusal(Write("k.yml",
                    Yaml(d, "R: [1., 0.2, 0., 0., 1., 0., 0., 0., 1.]\nT: [1., 0., 0.]\n" + size)))
          .find("no rotation"),
      std::string::npos);
  EXPECT_THROW(ReadStereoCalibration("/nowhere/cal.yml"), EnvironmentError);
}

TEST(StereoCalibration, LensesThatDoNotMapAreRefusedWithTheReason) {
  const std::string rest = std::string(kPose) + kSize;
  EXPECT_NE(
      Refusal(Write("a.yml", Yaml("[0., 0., 0., 0., 0., 0., 0., 0., 0.01, 0., 0., 0.]", rest)))
          .find("thin prism"),
      std::string::npos);
  EXPECT_NE(Refusal(Write("b.yml",
                          Yaml("[0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0.01, 0.]", rest)))
                .find("tilted sensor"),
            std::string::npos);
  // Zero in all of them is OPENCV8.
  EXPECT_EQ(Refusal(Write("c.yml", Yaml("[0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0.]", rest))),
            "");
  EXPECT_NE(
      Refusal(Write("d.yml", Yaml("[0., 0., 0., 0.]", rest + "distortion_model: equidistant\n")))
          .find("equidistant"),
      std::string::npos);
  EXPECT_NE(Refusal(Write("e.xml", "<a/>")).find("no calibration"), std::string::npos);
  EXPECT_NE(Refusal(Write("f.xml", "<a><b></a>")).find("no sound XML"), std::string::npos);
}

TEST(StereoCalibration, SkewIsLeftOutWithANoteWhileItIsSmallElseRefused) {
  const auto with_skew = [](const std::string& skew) {
    std::string text = Yaml("[0., 0., 0., 0.]", std::string(kPose) + kSize);
    text.replace(text.find("500., 0., 320."), 14, "500., " + skew + ", 320.");
    return Write("skew.yml", text);
  };
  // 0.2 px of skew times 240 / 500 of height over depth: 0.096 px.
  const StereoCalibrationFile read = ReadStereoCalibrationFile(with_skew("0.2"));
  ASSERT_FALSE(read.notes.empty());
  EXPECT_NE(read.notes[1].find("0.096 px"), std::string::npos) << read.notes[1];
  EXPECT_NE(Refusal(with_skew("0.3")).find("skew"), std::string::npos);
}

TEST(StereoCalibration, ReadsDiceGoldOfTheSimulatedRig) {
  PLUMBLINE_SHARED_DATA(folder, "cal-sim-known-truth");
  for (const char* name : {"sim_checkerboard_cal_gold.xml", "sim_dot_cal_gold.xml"}) {
    const StereoCalibrationFile read = ReadStereoCalibrationFile(folder / name);
    EXPECT_EQ(read.format, "DICe");
    EXPECT_NEAR(read.rig.baseline_mm(), 123.527, 0.001);
    EXPECT_NEAR(read.rig.left.parameters()[0], 6673.3159, 1e-9);
    EXPECT_NEAR(read.rig.right.parameters()[3], 531.635, 1e-9);
    EXPECT_EQ(read.rig.left.size(), (ImageSize{1920, 1200}));
    // beta is the turn about y: -19.07 degrees, nearly all of it.
    EXPECT_NEAR(read.rig.right_from_left.RotationVector().y() * 180 / std::numbers::pi, -19.0677,
                0.01);
    EXPECT_NEAR(AngleDegrees(read.rig), 19.07, 0.01);
  }
  // One camera only: no rig, but a camera.
  EXPECT_NE(Refusal(folder / "sim_white_dot_cal_gold.xml").find("1 camera"), std::string::npos);
  EXPECT_NEAR(ReadCameraCalibration(folder / "sim_white_dot_cal_gold.xml").parameters()[8], 20.433,
              1e-12);
}

TEST(StereoCalibration, ReadsDiceAndVic3dOfTheSameRig) {
  PLUMBLINE_SHARED_DATA(folder, "stereodic-challenge-S3-Dspecimen");
  const StereoCalibrationFile dice =
      ReadStereoCalibrationFile(folder / "reference_ALDIC/calibration_DICe.xml");
  EXPECT_NEAR(dice.rig.baseline_mm(), 123.60, 0.005);
  EXPECT_NEAR(AngleDegrees(dice.rig), 18.88, 0.01);
  const StereoCalibrationFile vic = ReadStereoCalibrationFile(folder / "reference_DICe/cal.xml");
  EXPECT_EQ(vic.format, "VIC-3D");
  EXPECT_NEAR(vic.rig.baseline_mm(), 123.21, 0.005);
  EXPECT_NEAR(AngleDegrees(vic.rig), 18.833, 0.001);
  EXPECT_EQ(vic.rig.left.size(), (ImageSize{1920, 1200}));
  EXPECT_EQ(vic.notes.size(), 3u);  // the distortion law, and two skews
  // Both describe one rig: a point at the working distance is seen where the other says, within the
  // few px that separate their principal points' freedom.
  const Eigen::Vector3d ray = vic.rig.left.Unproject({960, 600});
  const Eigen::Vector2d a = vic.rig.right.Project(vic.rig.right_from_left * (ray * 383.8));
  const Eigen::Vector3d ray_dice = dice.rig.left.Unproject({960, 600});
  const Eigen::Vector2d b = dice.rig.right.Project(dice.rig.right_from_left * (ray_dice * 383.8));
  EXPECT_LT((a - b).norm(), 40);
}

// The places that VIC-3D itself matched, as the file lists them. (They are not of the images beside
// it: those were taken with the cameras 12 degrees further apart.)
TEST(StereoCalibration, OfVic3dPutsItsOwnMatchesOnTheirEpipolarLines) {
  PLUMBLINE_SHARED_DATA(bar, "stereodic-static-bar");
  const StereoRig rig = ReadStereoCalibration(bar / "reference_DICe/cal.xml");
  EXPECT_EQ(rig.left.size(), (ImageSize{1280, 800}));
  for (const Eigen::Vector4d& seen :
       {Eigen::Vector4d(456, 121, 516.716, 104.7), Eigen::Vector4d(544, 369, 571.169, 350.874),
        Eigen::Vector4d(609, 326, 648.066, 309.293), Eigen::Vector4d(611, 242, 637.642, 227.563)}) {
    StereoObservation match;
    match.left = seen.head<2>();
    match.right = seen.tail<2>();
    match.cov_px2.setIdentity();
    EXPECT_LT(std::abs(Triangulate(rig, match).epipolar_px), 0.12) << seen.transpose();
  }
}

TEST(StereoCalibration, DicePosesInAWorldGiveTheRightCameraSeenFromTheLeft) {
  const auto camera = [](int c, const std::string& more) {
    return "<ParameterList name='CAMERA " + std::to_string(c) +
           "'><Parameter name='FX' value='1000'/><Parameter name='FY' value='1000'/>"
           "<Parameter name='CX' value='320'/><Parameter name='CY' value='240'/>"
           "<Parameter name='IMAGE_HEIGHT_WIDTH' value='{480, 640}'/>" +
           more + "</ParameterList>";
  };
  const std::string head =
      "<ParameterList><Parameter name='xml_file_format' value='DICe_xml_camera_system_file'/>";
  const std::string left = "<Parameter name='ALPHA' value='10'/><Parameter name='TX' value='5'/>";
  const std::string right =
      "<Parameter name='ALPHA' value='10'/><Parameter name='BETA' value='20'/><Parameter "
      "name='GAMMA' "
      "value='-5'/><Parameter name='TX' value='-95'/><Parameter name='TZ' value='7'/>";
  const auto d = [](double degrees) { return degrees * std::numbers::pi / 180; };
  using Eigen::AngleAxisd, Eigen::Vector3d;
  const Eigen::Matrix3d r0 = AngleAxisd(d(10), Vector3d::UnitX()).toRotationMatrix();
  const Eigen::Matrix3d r1 =
      (AngleAxisd(d(-5), Vector3d::UnitZ()) * AngleAxisd(d(20), Vector3d::UnitY()) *
       AngleAxisd(d(10), Vector3d::UnitX()))
          .toRotationMatrix();
  const Rigid3 world =
      ReadStereoCalibration(
          Write("w.xml", head + camera(0, left) + camera(1, right) + "</ParameterList>"))
          .right_from_left;
  EXPECT_LT((world.rotation - r1 * r0.transpose()).norm(), 1e-12);
  EXPECT_LT((world.translation_mm - (Vector3d(-95, 0, 7) - r1 * r0.transpose() * Vector3d(5, 0, 0)))
                .norm(),
            1e-12);
  const Rigid3 relative =
      ReadStereoCalibration(
          Write("r.xml",
                head + "<Parameter name='extrinsics_relative_camera_to_camera' value='true'/>" +
                    camera(0, left) + camera(1, right) + "</ParameterList>"))
          .right_from_left;
  EXPECT_LT((relative.rotation - r1).norm(), 1e-12);
  EXPECT_NE(Refusal(Write("s.xml", head + camera(0, "<Parameter name='S1' value='1e-3'/>") +
                                       camera(1, right) + "</ParameterList>"))
                .find("thin prism"),
            std::string::npos);
  EXPECT_NE(
      Refusal(Write("k.xml", head +
                                 camera(0,
                                        "<Parameter name='K1' value='1e-3'/><Parameter "
                                        "name='LENS_DISTORTION_MODEL' value='K1R1_K2R2_K3R3'/>") +
                                 camera(1, right) + "</ParameterList>"))
          .find("K1R1_K2R2_K3R3"),
      std::string::npos);
  EXPECT_NE(Refusal(Write("m.xml",
                          head + "<ParameterList name='CAMERA 0'></ParameterList></ParameterList>"))
                .find("'FX' is missing"),
            std::string::npos);
}

TEST(StereoCalibration, ReadsMatchIdTextAndRefusesIncompleteOnes) {
  const std::string text =
      "Cam1_Fx [pixels];6651.97\r\nCam1_Fy [pixels];6648,81\r\nCam1_Fs [pixels];0\nCam1_Kappa "
      "1;0.041\n"
      "Cam1_Kappa 2;-1.5\nCam1_Kappa 3;2\nCam1_P1;1e-4\nCam1_P2;-2e-4\nCam1_Cx [pixels];902.85\n"
      "Cam1_Cy [pixels];586.14\nCam2_Fx [pixels];6607.28\nCam2_Fy [pixels];6603.14\nCam2_Fs "
      "[pixels];0\n"
      "Cam2_Kappa 1;0.053\nCam2_Cx [pixels];935.32\nCam2_Cy [pixels];553.99\nTx [mm];174.15\n"
      "Ty [mm];0.65\nTz [mm];27.26\nTheta [deg];0.069\nPhi [deg];-18.97\nPsi [deg];0.263\n";
  const ForeignCalibrationOptions size{ImageSize{1920, 1200}, 1};
  const StereoCalibrationFile read = ReadStereoCalibrationFile(Write("cal.caldat", text), size);
  EXPECT_EQ(read.format, "MatchID");
  Eigen::VectorXd expected(9);
  expected << 6651.97, 6648.81, 902.85, 586.14, 0.041, -1.5, 1e-4, -2e-4, 2;
  EXPECT_EQ(read.rig.left.parameters(), expected);
  EXPECT_NEAR(read.rig.baseline_mm(), 176.27, 0.005);
  EXPECT_NEAR(read.rig.right_from_left.RotationVector().y() * 180 / std::numbers::pi, -18.97, 0.01);
  EXPECT_NE(Refusal(Write("cal.caldat", text)).find("--image-size"), std::string::npos);
  std::string cut = text;
  cut.erase(cut.find("Phi"), 17);
  EXPECT_NE(Refusal(Write("cut.caldat", cut), size).find("'phi' is missing"), std::string::npos);
  EXPECT_NE(Refusal(Write("k4.caldat", text + "Cam2_Kappa 4;1\n"), size).find("cam2_kappa4"),
            std::string::npos);
  EXPECT_NE(Refusal(Write("bad.caldat", text + "Cam2_P1;x\n"), size).find("no number"),
            std::string::npos);
}

TEST(CameraCalibration, ReadsOpenCvsMonoFileAndARosStyleOne) {
  const Camera ros = ReadCameraCalibration(
      Write("ros.yaml",
            "image_width: 640\nimage_height: 480\ncamera_name: left\ncamera_matrix:\n  rows: 3\n  "
            "cols: 3\n"
            "  data: [500.5, 0, 320, 0, 501, 240, 0, 0, 1]\ndistortion_model: plumb_bob\n"
            "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, 0, 0, 0, 0.2]\n"));
  EXPECT_EQ(ros.parameters()[0], 500.5);
  EXPECT_EQ(ros.parameters()[8], 0.2);
  PLUMBLINE_SHARED_DATA(folder, "cal-chessboard-opencv-stereo");
  const Camera camera = ReadCameraCalibration(folder / "left_intrinsics.yml");
  EXPECT_NEAR(camera.parameters()[0], 535.91573396, 1e-7);
  EXPECT_EQ(camera.size(), (ImageSize{640, 480}));
  // OpenCV's own sample: intrinsics without size and pose, which live elsewhere.
  EXPECT_NE(Refusal(folder / "intrinsics.yml").find("extrinsics.yml"), std::string::npos);
  EXPECT_NE(Refusal(folder / "stereo_calib.xml"), "");
}

}  // namespace
}  // namespace plumbline
