#include "apps/pipeline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "apps/internal/surface_points.h"
#include "calib/error.h"
#include "calib/triangulate.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

using ::testing::HasSubstr;

// Two cameras 60 mm apart that look at 400 mm, small images, some distortion.
StereoRig SmallRig() {
  const LensModel model{.kind = LensModel::Kind::kOpenCv5};
  Eigen::VectorXd left(9), right(9);
  left << 800, 802, 159, 121, -0.05, 0.02, 1e-4, -2e-4, 0;
  right << 805, 803, 161, 119, -0.04, 0.01, -1e-4, 1e-4, 0;
  StereoRig rig{Camera(model, {320, 240}, left),
                Camera(model, {320, 240}, right),
                Rigid3::FromRotationVector({0.002, -0.15, 0.001}, {-60, 0.3, 4}),
                {},
                "test"};
  return rig;
}

// Modes of a plausible size: focal lengths, principal points, distortion, the pose of the right
// camera, and the scale alone.
StereoRig WithModes(StereoRig rig) {
  const int p = rig.ParameterCount();
  rig.modes.modes = Eigen::MatrixXd::Zero(4, p);
  rig.modes.modes(0, 0) = rig.modes.modes(0, 1) = 0.5;
  rig.modes.modes(1, 2) = 0.6;
  rig.modes.modes(1, p - 5) = 6e-4;
  rig.modes.modes(2, p - 6) = 1e-4;
  rig.modes.modes(2, p - 3) = 0.02;
  rig.modes.modes.row(3).tail<3>() = 1e-3 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
  return rig;
}

struct Wave {
  double u, v, phase;
};

std::vector<Wave> MakeWaves() {
  std::vector<Wave> waves;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int k = 0; k < 24; ++k) {
    const double angle = 2 * M_PI * uniform(random);
    const double frequency = 0.8 + 2.0 * uniform(random);
    waves.push_back(
        {frequency * std::cos(angle), frequency * std::sin(angle), 2 * M_PI * uniform(random)});
  }
  return waves;
}

// A smooth random texture on the plane (u, v in mm), the same for both cameras.
double Texture(double u, double v) {
  static const std::vector<Wave> waves = MakeWaves();
  double sum = 0;
  for (const Wave& wave : waves) sum += std::sin(wave.u * u + wave.v * v + wave.phase);
  return std::clamp(128 + 22 * sum, 0.0, 255.0);
}

// What a camera sees of the plane normal . point = offset.
GrayImage Render(const Camera& camera, const Rigid3& camera_from_rig, const Eigen::Vector3d& normal,
                 double offset) {
  GrayImage image;
  image.grey = Image<std::uint16_t>(camera.size());
  const Rigid3 rig_from_camera = camera_from_rig.Inverse();
  const Eigen::Vector3d e1 = (Eigen::Vector3d::UnitX() - normal.x() * normal).normalized();
  const Eigen::Vector3d e2 = normal.cross(e1);
  for (int y = 0; y < camera.size().height; ++y) {
    for (int x = 0; x < camera.size().width; ++x) {
      const Eigen::Vector3d ray =
          rig_from_camera.rotation * camera.Unproject(Eigen::Vector2d(x, y));
      const Eigen::Vector3d& c = rig_from_camera.translation_mm;
      const Eigen::Vector3d p = c + ray * (offset - normal.dot(c)) / normal.dot(ray);
      image.grey(y, x) = static_cast<std::uint16_t>(std::lround(Texture(e1.dot(p), e2.dot(p))));
    }
  }
  return image;
}

struct Wall {
  Eigen::Vector3d normal = Eigen::Vector3d(0.1, 0.25, -1).normalized();
  double offset = normal.dot(Eigen::Vector3d(0, 0, 400));
  StereoFrame Photograph(const StereoRig& rig) const {
    StereoFrame pair;
    pair.left_id = "left";
    pair.right_id = "right";
    pair.left = Render(rig.left, {}, normal, offset);
    pair.right = Render(rig.right, rig.right_from_left, normal, offset);
    return pair;
  }
};

MeasureOptions NearOptions() {
  MeasureOptions options;
  options.min_distance_mm = 330;
  options.max_distance_mm = 480;
  return options;
}

TEST(SurfacePoints, CovarianceOfTheRightPixelFollowsTheEpipolarLine) {
  const StereoRig rig = SmallRig();
  const Rectification rectification(rig);
  const Eigen::Vector2d at(rectification.size().width / 2.0, rectification.size().height / 2.0);
  const double disparity = rectification.DisparityAtDistance(400);
  const auto match = internal::MatchFromDisparity(rectification, at, rectification.LeftRawPixel(at),
                                                  disparity, 0.1);
  const auto right = [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
    return rectification.RightRawPixel({at.x() - d[0], at.y()});
  };
  const Eigen::MatrixXd J =
      testing::NumericJacobian(right, Eigen::VectorXd::Constant(1, disparity));
  EXPECT_LT((match.cov_px2.bottomRightCorner(2, 2) - 0.01 * J * J.transpose()).norm(), 1e-8);
  EXPECT_EQ(match.cov_px2.topRows(2).norm(), 0);
  // And the correspondence meets in space: its epipolar distance vanishes.
  const TriangulatedPoint point = Triangulate(rig, {match.left, match.right, match.cov_px2});
  EXPECT_EQ(point.status, Status::kOk);
  EXPECT_NEAR(point.epipolar_px, 0, 1e-6);
}

TEST(SurfacePoints, BestRigidMotionUndoesAMotion) {
  std::mt19937 random(3);
  std::normal_distribution<double> gauss(0, 50);
  const Rigid3 motion = Rigid3::FromRotationVector({0.1, -0.2, 0.3}, {5, -7, 400});
  std::vector<Eigen::Vector3d> from, to;
  for (int i = 0; i < 100; ++i) {
    from.emplace_back(gauss(random), gauss(random), gauss(random));
    to.push_back(motion * from.back());
  }
  from[7].setConstant(NAN);
  const Rigid3 found = internal::BestRigidMotion(from, to);
  EXPECT_LT((found.Matrix() - motion.Matrix()).norm(), 1e-9);
}

TEST(StereoMeasurement, MeasuresAPlaneInTheGroundFrame) {
  const StereoRig rig = WithModes(SmallRig());
  const Wall wall;
  const StereoMeasurement measurement(rig, NearOptions());
  const MeasuredFrame measured = measurement.Measure(wall.Photograph(rig));
  const SeriesFrame& frame = measured.frame;
  ASSERT_EQ(frame.problem, "");
  ASSERT_TRUE(frame.ground.found) << frame.ground.problem;
  EXPECT_EQ(frame.surface.frame, SurfaceFrame::kGround);
  EXPECT_GT(measured.summary.valid_points, 0.2 * static_cast<double>(measured.summary.grid_points));
  // The plane is found within what it claims, random part alone: the rig is exact here. Three
  // sigma, and a floor for the texture's 8 bits.
  const double sigma_offset = std::sqrt(frame.ground.cov_random(2, 2));
  EXPECT_NEAR(frame.ground.normal_in_rig.dot(frame.ground.centroid_in_rig_mm) -
                  wall.normal.dot(frame.ground.centroid_in_rig_mm) +
                  (wall.offset - frame.ground.offset_mm),
              0, 4 * sigma_offset + 0.01);
  EXPECT_LT(std::acos(std::min(1.0, frame.ground.normal_in_rig.dot(wall.normal))), 1e-3);
  EXPECT_LT(frame.ground.rms_mm, 0.5);
  // Heights scatter about zero, and the left image's pixel is where the point is seen.
  double height = 0;
  int count = 0;
  const Rigid3 rig_from_ground = frame.ground.ground_from_rig.Inverse();
  for (int r = 0; r < frame.surface.status.height(); ++r) {
    for (int c = 0; c < frame.surface.status.width(); ++c) {
      const Eigen::Vector3f& p = frame.surface.position_mm(r, c);
      if (frame.surface.status(r, c) != Status::kOk) {
        EXPECT_FALSE(p.allFinite());
        continue;
      }
      EXPECT_TRUE(frame.surface.sigma_random_mm(r, c).allFinite());
      EXPECT_GT(frame.surface.sigma_calibration_mm(r, c).norm(), 0);
      height += p.z();
      ++count;
      if (count % 997 == 0) {
        const Eigen::Vector2d pixel = rig.left.Project(rig_from_ground * p.cast<double>());
        EXPECT_LT((pixel - measurement.grid_px()(r, c).cast<double>()).norm(), 0.02);
      }
    }
  }
  EXPECT_NEAR(height / count, 0, 0.05);
}

TEST(StereoMeasurement, CalibrationSigmaIsThatOfAPerturbedRig) {
  // With one mode, a rig that is wrong by exactly this mode must err by exactly its sigma.
  StereoRig rig = SmallRig();
  rig.modes.modes = Eigen::MatrixXd::Zero(1, rig.ParameterCount());
  rig.modes.modes.row(0).tail<3>() = 1e-3 * rig.right_from_left.translation_mm.transpose();
  const Wall wall;
  const StereoFrame pair = wall.Photograph(rig);
  MeasureOptions options = NearOptions();
  options.step_px = 3;
  const MeasuredFrame measured = StereoMeasurement(rig, options).Measure(pair);
  ASSERT_TRUE(measured.frame.ground.found);
  // A scale of 1e-3 moves a point at (x, y) in the plane by 1e-3 of it, and the plane by 1e-3 of
  // its distance.
  const Surface& surface = measured.frame.surface;
  for (std::size_t i = 0; i < surface.status.pixel_count(); i += 101) {
    if (surface.status.values()[i] != Status::kOk) continue;
    const Eigen::Vector3f& p = surface.position_mm.values()[i];
    const Eigen::Vector3f& sigma = surface.sigma_calibration_mm.values()[i];
    EXPECT_NEAR(sigma.x(), 1e-3 * std::abs(p.x()), 2e-4);
    EXPECT_NEAR(sigma.y(), 1e-3 * std::abs(p.y()), 2e-4);
  }
  EXPECT_NEAR(std::sqrt(measured.frame.ground.cov_calibration(2, 2)),
              1e-3 * std::abs(measured.frame.ground.offset_mm), 2e-3);
}

TEST(StereoMeasurement, RigFrameErrorsLeaveOutTheRigidMotionOfTheFrame) {
  StereoRig rig = SmallRig();
  // A principal point of the left camera that is wrong turns everything it sees, and little else.
  rig.modes.modes = Eigen::MatrixXd::Zero(1, rig.ParameterCount());
  rig.modes.modes(0, 2) = 1;
  rig.modes.modes(0, rig.left.parameter_count() + 2) = 1.0;
  MeasureOptions options = NearOptions();
  options.turn_into_ground_frame = false;
  options.step_px = 3;
  const MeasuredFrame measured = StereoMeasurement(rig, options).Measure(Wall{}.Photograph(rig));
  ASSERT_EQ(measured.frame.problem, "");
  EXPECT_EQ(measured.frame.surface.frame, SurfaceFrame::kRig);
  double largest = 0;
  for (std::size_t i = 0; i < measured.frame.surface.status.pixel_count(); ++i) {
    if (measured.frame.surface.status.values()[i] != Status::kOk) continue;
    largest =
        std::max<double>(largest, measured.frame.surface.sigma_calibration_mm.values()[i].norm());
  }
  // 1 px is 0.5 mm here when the motion is left in.
  EXPECT_LT(largest, 0.3);
}

TEST(StereoMeasurement, WithoutModesTheCalibrationPartIsUnknown) {
  const StereoRig rig = SmallRig();
  MeasureOptions options = NearOptions();
  options.step_px = 4;
  const MeasuredFrame measured = StereoMeasurement(rig, options).Measure(Wall{}.Photograph(rig));
  ASSERT_TRUE(measured.frame.ground.found);
  EXPECT_TRUE(std::isnan(measured.frame.ground.cov_calibration(0, 0)));
  for (const auto& sigma : measured.frame.surface.sigma_calibration_mm.values()) {
    EXPECT_TRUE(std::isnan(sigma.z()));
  }
}

TEST(StereoMeasurement, RegionAndMaskLimitTheGrid) {
  const StereoRig rig = SmallRig();
  MeasureOptions options = NearOptions();
  options.roi = PixelRegion{100, 60, 160, 120};
  options.mask = Image<std::uint8_t>(rig.left.size(), 1);
  for (int y = 0; y < 240; ++y) {
    for (int x = 0; x < 120; ++x) options.mask(y, x) = 0;
  }
  const StereoMeasurement measurement(rig, options);
  const MeasuredFrame measured = measurement.Measure(Wall{}.Photograph(rig));
  ASSERT_EQ(measured.frame.problem, "");
  int ok = 0;
  for (int r = 0; r < measurement.grid_px().height(); ++r) {
    for (int c = 0; c < measurement.grid_px().width(); ++c) {
      if (measured.frame.surface.status(r, c) != Status::kOk) continue;
      const Eigen::Vector2f& pixel = measurement.grid_px()(r, c);
      EXPECT_GT(pixel.x(), 119);
      EXPECT_LT(pixel.x(), 260.5);
      EXPECT_GT(pixel.y(), 59);
      EXPECT_LT(pixel.y(), 180.5);
      ++ok;
    }
  }
  EXPECT_GT(ok, 500);
  options.mask = Image<std::uint8_t>({10, 10}, 1);
  EXPECT_THROW(StereoMeasurement(rig, options), InputError);
  options.mask = Image<std::uint8_t>(rig.left.size(), 0);
  EXPECT_THROW(StereoMeasurement(rig, options), InputError);
}

TEST(StereoMeasurement, RefusesImagesOfAnotherSizeAndKeepsBadFramesApart) {
  const StereoRig rig = SmallRig();
  const StereoMeasurement measurement(rig, NearOptions());
  StereoFrame pair;
  pair.left_id = "l.png";
  pair.right_id = "r.png";
  pair.left.grey = Image<std::uint16_t>({300, 200}, 7);
  pair.right.grey = Image<std::uint16_t>({320, 240}, 7);
  try {
    static_cast<void>(measurement.Measure(pair));
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("l.png is 300x200 px"));
  }
  pair.problem = "l.png is truncated.";
  const MeasuredFrame bad = measurement.Measure(pair);
  EXPECT_EQ(bad.frame.problem, "l.png is truncated.");
  EXPECT_TRUE(bad.frame.surface.status.empty());
  // Two black images: nothing to match, and that is said.
  pair.problem.clear();
  pair.left.grey = Image<std::uint16_t>({320, 240}, 7);
  EXPECT_NE(measurement.Measure(pair).frame.problem, "");
}

}  // namespace
}  // namespace plumbline
