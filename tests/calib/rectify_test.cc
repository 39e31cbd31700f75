#include "calib/rectify.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <iomanip>
#include <opencv2/imgproc.hpp>
#include <random>
#include <sstream>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

Camera MakeCamera(const char* model_name, ImageSize size, double f) {
  const LensModel model = LensModel::FromName(model_name);
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  p.head<4>() << f, f * 1.001, size.width / 2.0 + 7, size.height / 2.0 - 5;
  if (model.IsSplined()) {
    std::mt19937 rng(3);
    std::normal_distribution<double> noise(0, 0.003);
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = noise(rng);
  } else {
    const double d[] = {-0.05, 0.02, 1e-3, -7e-4, 0.001, 0.02, 0.01, 0.001};
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = d[i - 4];
  }
  return Camera(model, size, p);
}

struct Case {
  const char* name;
  const char* model;
  ImageSize size;
  double f;
  Eigen::Vector3d r;
  Eigen::Vector3d t;
  double distance_mm;
  RectificationKind kind;
  RectificationKind expected;

  StereoRig Rig() const {
    const Camera camera = MakeCamera(model, size, f);
    Eigen::VectorXd p = camera.parameters();
    p.head<4>() += Eigen::Vector4d(f * 0.004, f * 0.003, 9, -4);
    return {camera, camera.WithParameters(p), Rigid3::FromRotationVector(r, t), {}, ""};
  }
  Rectification Make() const {
    RectificationOptions options;
    options.kind = kind;
    return {Rig(), options};
  }
};

constexpr auto kAuto = RectificationKind::kAuto;
constexpr auto kPinhole = RectificationKind::kPinhole;
constexpr auto kLatLon = RectificationKind::kLatLon;
constexpr const char* kSplined =
    "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=11_fov_x_deg=120";

// A long lens at 19 degrees (the left camera looks along its own z, the working point lies on it),
// a parallel rig, and wide ones.
const Case kCases[] = {
    {"LongLens",
     "OPENCV5",
     {1920, 1200},
     6640,
     {0.004, 0.33, -0.01},
     {-122, 1, 20},
     380,
     kAuto,
     kPinhole},
    {"LongLensLatLon",
     "OPENCV5",
     {1920, 1200},
     6640,
     {0.004, 0.33, -0.01},
     {-122, 1, 20},
     380,
     kLatLon,
     kLatLon},
    {"Parallel", "OPENCV5", {640, 480}, 900, {0, 0, 0}, {-60, 0, 0}, 500, kAuto, kPinhole},
    {"Vertical", "OPENCV5", {640, 480}, 900, {-0.1, 0.01, 0.02}, {1, -60, 3}, 500, kAuto, kPinhole},
    {"Wide", "OPENCV8", {1280, 960}, 530, {0.01, 0.12, 0.02}, {-100, 2, 8}, 600, kAuto, kLatLon},
    {"WideSplined",
     kSplined,
     {1280, 960},
     560,
     {0.01, 0.12, 0.02},
     {-100, 2, 8},
     600,
     kAuto,
     kLatLon},
    {"WidePinhole",
     "OPENCV8",
     {1280, 960},
     530,
     {0.01, 0.12, 0.02},
     {-100, 2, 8},
     600,
     kPinhole,
     kPinhole}};

class EveryRig : public ::testing::TestWithParam<Case> {
 protected:
  // Points that both cameras see, with their raw pixels.
  struct Seen {
    Eigen::Vector3d point;
    Eigen::Vector2d left, right;
  };
  std::vector<Seen> SeenPoints(const StereoRig& rig, int count) const {
    std::mt19937 rng(5);
    std::uniform_real_distribution<double> x(0, rig.left.size().width - 1.0),
        y(0, rig.left.size().height - 1.0), z(0.8, 1.3);
    std::vector<Seen> seen;
    while (static_cast<int>(seen.size()) < count) {
      const Eigen::Vector2d q(x(rng), y(rng));
      const Eigen::Vector3d point = GetParam().distance_mm * z(rng) * rig.left.Unproject(q);
      const Eigen::Vector2d right = rig.right.Project(rig.right_from_left * point);
      if (rig.right.Contains(right)) seen.push_back({point, q, right});
    }
    return seen;
  }
};

TEST_P(EveryRig, PutsEpipolarLinesOnRows) {
  const StereoRig rig = GetParam().Rig();
  const Rectification r = GetParam().Make();
  ASSERT_EQ(r.kind(), GetParam().expected);
  for (const Seen& s : SeenPoints(rig, 300)) {
    const Eigen::Vector2d left = r.LeftRectifiedPixel(s.left);
    const Eigen::Vector2d right = r.RightRectifiedPixel(s.right);
    ASSERT_NEAR(left.y(), right.y(), 1e-6);
    const double disparity = left.x() - right.x();
    ASSERT_LT((r.PointInRig(left, disparity) - s.point).norm(), 1e-6 * s.point.norm());
    if (r.kind() == kPinhole) {
      const double z = (r.rectified_from_left() * s.point).z();
      ASSERT_NEAR(disparity,
                  r.LeftIntrinsics()[0] * rig.baseline_mm() / z - r.ZeroDisparityOffset_px(), 1e-6);
    }
  }
}

TEST_P(EveryRig, HoldsWhatBothCamerasSee) {
  const Rectification r = GetParam().Make();
  const ImageSize raw = GetParam().size;
  for (const Seen& s : SeenPoints(GetParam().Rig(), 300)) {
    const Eigen::Vector2d q = r.LeftRectifiedPixel(s.left);
    EXPECT_TRUE(q.x() > -1 && q.y() > -1 && q.x() < r.size().width && q.y() < r.size().height)
        << q.transpose();
  }
  const double pixels = static_cast<double>(r.size().width) * r.size().height;
  EXPECT_LE(pixels, 4.05 * raw.width * raw.height);
}

TEST_P(EveryRig, RawAndRectifiedPixelsGoThereAndBack) {
  const Rectification r = GetParam().Make();
  for (const Seen& s : SeenPoints(GetParam().Rig(), 50)) {
    EXPECT_LT((r.LeftRawPixel(r.LeftRectifiedPixel(s.left)) - s.left).norm(), 1e-7);
    EXPECT_LT((r.RightRawPixel(r.RightRectifiedPixel(s.right)) - s.right).norm(), 1e-7);
  }
}

TEST_P(EveryRig, JacobiansMatchFiniteDifferences) {
  const Rectification r = GetParam().Make();
  using Function =
      Eigen::Vector2d (Rectification::*)(const Eigen::Vector2d&, Eigen::Matrix2d*) const;
  const auto check = [&](Function f, const Eigen::Vector2d& at) {
    Eigen::Matrix2d J;
    EXPECT_LT(((r.*f)(at, &J) - (r.*f)(at, nullptr)).norm(), 1e-9);
    const Eigen::MatrixXd numeric = testing::NumericJacobian(
        [&](const Eigen::VectorXd& q) -> Eigen::VectorXd { return (r.*f)(q.head<2>(), nullptr); },
        at);
    EXPECT_LT((J - numeric).norm(), 1e-6 * numeric.norm());
  };
  for (const Seen& s : SeenPoints(GetParam().Rig(), 5)) {
    check(&Rectification::LeftRectifiedPixel, s.left);
    check(&Rectification::RightRectifiedPixel, s.right);
    check(&Rectification::LeftRawPixel, r.LeftRectifiedPixel(s.left));
    check(&Rectification::RightRawPixel, r.RightRectifiedPixel(s.right));
  }
}

TEST_P(EveryRig, DisparityAndDistanceGoThereAndBack) {
  const Rectification r = GetParam().Make();
  for (const double scale : {0.8, 1.0, 1.3}) {
    const double distance_mm = scale * GetParam().distance_mm;
    EXPECT_NEAR(r.DistanceAtDisparity(r.DisparityAtDistance(distance_mm)), distance_mm, 1e-6);
  }
  EXPECT_GT(r.DisparityAtDistance(300), r.DisparityAtDistance(400));
}

// mrcal's axes, mrcal's projection of our intrinsics, and mrcal's stereo_unproject, whose disparity
// has no offset.
TEST_P(EveryRig, AgreesWithMrcal) {
  const StereoRig rig = GetParam().Rig();
  const Rectification r = GetParam().Make();
  const auto list = [](const auto& v) {
    std::ostringstream text;
    text << std::setprecision(17) << "np.array((";
    for (Eigen::Index i = 0; i < v.size(); ++i) text << v(i) << ",";
    return text.str() + "))";
  };
  const std::string kind = r.kind() == kPinhole ? "PINHOLE" : "LATLON";
  std::ostringstream script;
  script << std::setprecision(17) << "import numpy as np, mrcal\n"
         << "def model(p,rt): return mrcal.cameramodel(intrinsics=('" << rig.left.model().Name()
         << "',p), imagersize=(" << rig.left.size().width << "," << rig.left.size().height
         << "), extrinsics_rt_fromref=rt)\n"
         << "m=(model(" << list(rig.left.parameters()) << ",np.zeros(6)),model("
         << list(rig.right.parameters()) << "," << list(rig.Parameters().tail<6>()) << "))\n"
         << "rectified=mrcal.rectified_system(m,az_fov_deg=40,el_fov_deg=30,"
         << "rectification_model='LENSMODEL_" << kind << "')\n"
         << "print(*rectified[0].extrinsics_Rt_fromref()[:3].ravel())\n"
         << "L=" << list(r.LeftIntrinsics()) << "\nR=" << list(r.RightIntrinsics()) << "\n"
         << "rectified=[mrcal.cameramodel(intrinsics=('LENSMODEL_" << kind << "',L),imagersize=("
         << r.size().width << "," << r.size().height
         << "),extrinsics_Rt_fromref=x.extrinsics_Rt_fromref()) for x in rectified]\n"
         << "R01=rectified[0].extrinsics_Rt_fromref()\n";
  const auto seen = SeenPoints(rig, 20);
  for (const Seen& s : seen) {
    const Eigen::Vector2d left = r.LeftRectifiedPixel(s.left);
    const double mrcal_disparity =
        left.x() - r.RightRectifiedPixel(s.right).x() + r.ZeroDisparityOffset_px();
    script << "p=" << list(s.point) << "\n"
           << "q0=mrcal.project(mrcal.transform_point_Rt(rectified[0].extrinsics_Rt_fromref(),p),"
           << "*rectified[0].intrinsics())\n"
           << "q1=mrcal.project(mrcal.transform_point_Rt(rectified[1].extrinsics_Rt_fromref(),p),"
           << "'LENSMODEL_" << kind << "',R)\n"
           << "v=mrcal.stereo_unproject(np.array(" << mrcal_disparity
           << "),models_rectified=rectified,qrect0=" << list(left) << ")\n"
           << "print(*q0,*q1,*(R01[:3].T@v))\n";
  }
  const auto python = testing::RunPython(script.str());
  ASSERT_EQ(python.exit_code, 0) << python.output;
  std::istringstream numbers(python.output);
  Eigen::Matrix3d rotation;
  for (int i = 0; i < 9; ++i) ASSERT_TRUE(numbers >> rotation(i / 3, i % 3)) << python.output;
  EXPECT_LT((rotation - r.rectified_from_left()).norm(), 1e-9);
  for (const Seen& s : seen) {
    Eigen::Vector2d left, right;
    Eigen::Vector3d point;
    ASSERT_TRUE(numbers >> left[0] >> left[1] >> right[0] >> right[1]) << python.output;
    ASSERT_TRUE(numbers >> point[0] >> point[1] >> point[2]) << python.output;
    EXPECT_LT((r.LeftRectifiedPixel(s.left) - left).norm(), 1e-6);
    EXPECT_LT((r.RightRectifiedPixel(s.right) - right).norm(), 1e-6);
    EXPECT_LT((point - s.point).norm(), 1e-6 * s.point.norm());
  }
}

INSTANTIATE_TEST_SUITE_P(Rectification, EveryRig, ::testing::ValuesIn(kCases),
                         [](const auto& info) { return std::string(info.param.name); });

GrayImage Texture(ImageSize size) {
  GrayImage image{Image<std::uint16_t>(size), 12};
  std::mt19937 rng(1);
  for (auto& grey : image.grey.values()) grey = static_cast<std::uint16_t>(rng() % 4096);
  return image;
}

TEST(Rectification, ConvergingCamerasGetSmallDisparitiesAtTheWorkingDistance) {
  const Rectification r = kCases[0].Make();
  // Disparities without the offset would be f B / z, more than 2000 px.
  EXPECT_GT(r.ZeroDisparityOffset_px(), 1800);
  const StereoRig rig = kCases[0].Rig();
  const Eigen::Vector3d near(0, 0, 366);  // about where these axes come closest
  const double disparity = r.LeftRectifiedPixel(rig.left.Project(near)).x() -
                           r.RightRectifiedPixel(rig.right.Project(rig.right_from_left * near)).x();
  EXPECT_LT(std::abs(disparity), 100);

  RectificationOptions options;
  options.working_distance_mm = 383.8;
  const Rectification at(rig, options);
  const Eigen::Vector3d point(0, 0, 383.8);
  EXPECT_NEAR(at.LeftRectifiedPixel(rig.left.Project(point)).x(),
              at.RightRectifiedPixel(rig.right.Project(rig.right_from_left * point)).x(), 1e-6);
}

TEST(Rectification, KeepsTheInputResolutionWhereItLooks) {
  const Rectification r = kCases[0].Make();
  Eigen::Matrix2d J;
  (void)r.LeftRawPixel({r.size().width / 2.0, r.size().height / 2.0}, &J);
  EXPECT_NEAR(std::sqrt(std::abs(J.determinant())), 1, 0.03);
  RectificationOptions half;
  half.pixels_per_input_pixel = 0.5;
  EXPECT_NEAR(Rectification(kCases[0].Rig(), half).size().width, r.size().width / 2.0, 2);
}

TEST(Rectification, RemapsLikeOpenCv) {
  const Rectification r = kCases[4].Make();
  const GrayImage image = Texture(kCases[4].size);
  Image<std::uint8_t> valid;
  const GrayImage ours = r.RemapRight(image, &valid);
  ASSERT_TRUE(ours.size() == r.size());
  EXPECT_EQ(ours.bits, 12);
  cv::Mat source(image.height(), image.width(), CV_32F),
      map_x(r.size().height, r.size().width, CV_32F);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) source.at<float>(y, x) = image.grey(y, x);
  }
  cv::GaussianBlur(source, source, {}, 3);
  GrayImage smooth = image;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      source.at<float>(y, x) = std::round(source.at<float>(y, x));
      smooth.grey(y, x) = static_cast<std::uint16_t>(source.at<float>(y, x));
    }
  }
  cv::Mat map_y = map_x.clone(), theirs;
  for (int y = 0; y < map_x.rows; ++y) {
    for (int x = 0; x < map_x.cols; ++x) {
      const Eigen::Vector2d q = r.RightRawPixel(Eigen::Vector2d(x, y));
      map_x.at<float>(y, x) = static_cast<float>(q.x());
      map_y.at<float>(y, x) = static_cast<float>(q.y());
    }
  }
  cv::remap(source, theirs, map_x, map_y, cv::INTER_LINEAR);
  const GrayImage remapped = r.RemapRight(smooth);
  int inside = 0;
  double largest = 0;
  for (int y = 0; y < map_x.rows; ++y) {
    for (int x = 0; x < map_x.cols; ++x) {
      const double qx = map_x.at<float>(y, x), qy = map_y.at<float>(y, x);
      const bool expected =
          qx >= 0 && qy >= 0 && qx <= image.width() - 1 && qy <= image.height() - 1;
      ASSERT_EQ(valid(y, x), expected ? 255 : 0) << x << ", " << y;
      if (!expected) continue;
      ++inside;
      // OpenCV rounds the place to 1/32 px: up to 1/64 px of the steepest grey slope.
      largest = std::max(largest, std::abs(static_cast<double>(remapped.grey(y, x)) -
                                           static_cast<double>(theirs.at<float>(y, x))));
    }
  }
  EXPECT_GT(inside, map_x.rows * map_x.cols / 4);
  EXPECT_LT(largest, 6);
}

TEST(Rectification, RemapIsExactOnARamp) {
  const Rectification r = kCases[0].Make();
  GrayImage ramp{Image<std::uint16_t>(kCases[0].size), 16};
  for (int y = 0; y < ramp.height(); ++y) {
    for (int x = 0; x < ramp.width(); ++x) {
      ramp.grey(y, x) = static_cast<std::uint16_t>(20 * x + 10 * y);
    }
  }
  Image<std::uint8_t> valid;
  const GrayImage out = r.RemapLeft(ramp, &valid);
  for (int y = 0; y < out.height(); y += 17) {
    for (int x = 0; x < out.width(); x += 13) {
      if (valid(y, x) == 0) continue;
      const Eigen::Vector2d q = r.LeftRawPixel(Eigen::Vector2d(x, y));
      ASSERT_NEAR(out.grey(y, x), 20 * q.x() + 10 * q.y(), 0.51);
    }
  }
}

TEST(Rectification, GivesTheSameBitsForAnyNumberOfThreads) {
  const GrayImage image = Texture(kCases[4].size);
  GrayImage one_thread;
  {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
    one_thread = kCases[4].Make().RemapLeft(image);
  }
  EXPECT_EQ(one_thread.grey.values(), kCases[4].Make().RemapLeft(image).grey.values());
}

TEST(Rectification, BatchesGiveTheSameBitsAsSinglePixels) {
  const Rectification r = kCases[0].Make();
  std::vector<Eigen::Vector2d> q;
  for (int i = 0; i < 3000; ++i) q.emplace_back(0.6 * i, 0.31 * i);
  std::vector<Eigen::Vector2d> left(q.size()), right(q.size());
  std::vector<Eigen::Matrix2d> d(q.size());
  r.LeftRawPixels(q, left, d);
  r.RightRawPixels(q, right);
  for (std::size_t i = 500; i < 2500; i += 77) {
    Eigen::Matrix2d J;
    EXPECT_EQ(left[i], r.LeftRawPixel(q[i], &J));
    EXPECT_EQ(d[i], J);
    EXPECT_EQ(right[i], r.RightRawPixel(q[i]));
  }
}

TEST(Rectification, RefusesCamerasWithNothingInCommon) {
  StereoRig rig = kCases[2].Rig();
  rig.right_from_left = Rigid3::FromRotationVector({0, -1.5, 0}, {-60, 0, 0});
  const auto make = [&] { return Rectification(rig); };
  EXPECT_THROW(make(), InputError);  // they look apart
  rig.right_from_left = Rigid3::FromRotationVector({1.2, 0, 0}, {-60, 0, 0});
  EXPECT_THROW(make(), InputError);  // one looks up
  rig.right_from_left = Rigid3{};
  EXPECT_THROW(make(), InputError);  // one place
  rig.right_from_left.translation_mm = {0, 0, -50};
  EXPECT_THROW(make(), InputError);  // one behind the other
}

TEST(Rectification, RefusesBadOptionsAndForeignPhotographs) {
  RectificationOptions options;
  options.working_distance_mm = -3;
  EXPECT_THROW(Rectification(kCases[2].Rig(), options), UsageError);
  options = {};
  options.pixels_per_input_pixel = 0;
  EXPECT_THROW(Rectification(kCases[2].Rig(), options), UsageError);
  const Rectification r = kCases[2].Make();
  EXPECT_THROW((void)r.RemapLeft(Texture({320, 240})), InputError);
}

}  // namespace
}  // namespace plumbline
