#include "calib/camera.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

Camera MakeCamera(LensModel::Kind kind) {
  LensModel model;
  model.kind = kind;
  if (model.IsSplined()) {
    model.knots_x = 11;
    model.knots_y = 8;
    model.fov_x_deg = 90;
  }
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  p.head<4>() << 500, 505, 330, 235;
  if (model.IsSplined()) {
    std::mt19937 rng(3);
    std::normal_distribution<double> noise(0, 0.005);
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = noise(rng);
  } else {
    const double d[] = {-0.21, 0.05, 1e-3, -7e-4, 0.01, 0.02, 0.01, 0.003};
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = d[i - 4];
  }
  return Camera(model, {640, 480}, p);
}

std::string ModelName(const ::testing::TestParamInfo<LensModel::Kind>& info) {
  const char* const names[] = {"OpenCv4", "OpenCv5", "OpenCv8", "Splined"};
  return names[static_cast<int>(info.param)];
}

class EveryModel : public ::testing::TestWithParam<LensModel::Kind> {};

TEST_P(EveryModel, UnprojectInvertsProject) {
  const Camera camera = MakeCamera(GetParam());
  for (double y = 0; y < 480; y += 37) {
    for (double x = 0; x < 640; x += 41) {
      const Eigen::Vector3d ray = camera.Unproject({x, y});
      ASSERT_TRUE(ray.allFinite()) << x << ", " << y;
      EXPECT_NEAR(ray.norm(), 1, 1e-12);
      EXPECT_NEAR((camera.Project(ray * 160) - Eigen::Vector2d(x, y)).norm(), 0, 2e-9);
    }
  }
}

TEST_P(EveryModel, ProjectionJacobiansMatchFiniteDifferences) {
  const Camera camera = MakeCamera(GetParam());
  const Eigen::Vector3d point(31, -22, 150);
  const auto at = camera.ProjectWithJacobians(point);
  EXPECT_EQ(at.pixel, camera.Project(point));
  const auto d_point = testing::NumericJacobian(
      [&](const Eigen::VectorXd& p) -> Eigen::VectorXd {
        return camera.Project(Eigen::Vector3d(p));
      },
      point);
  EXPECT_LT((at.d_pixel_d_point - d_point).norm(), 1e-6 * d_point.norm());
  const auto d_parameters = testing::NumericJacobian(
      [&](const Eigen::VectorXd& p) -> Eigen::VectorXd {
        return camera.WithParameters(p).Project(point);
      },
      camera.parameters());
  EXPECT_LT((at.d_pixel_d_parameters - d_parameters).norm(), 1e-6 * d_parameters.norm());
}

TEST_P(EveryModel, UnprojectionJacobiansMatchFiniteDifferences) {
  const Camera camera = MakeCamera(GetParam());
  const Eigen::Vector2d pixel(411.3, 120.7);
  const auto at = camera.UnprojectWithJacobians(pixel);
  const auto d_pixel = testing::NumericJacobian(
      [&](const Eigen::VectorXd& q) -> Eigen::VectorXd {
        return camera.Unproject(Eigen::Vector2d(q));
      },
      pixel);
  EXPECT_LT((at.d_ray_d_pixel - d_pixel).norm(), 1e-6 * d_pixel.norm());
  const auto d_parameters = testing::NumericJacobian(
      [&](const Eigen::VectorXd& p) -> Eigen::VectorXd {
        return camera.WithParameters(p).Unproject(pixel);
      },
      camera.parameters());
  EXPECT_LT((at.d_ray_d_parameters - d_parameters).norm(), 1e-5 * d_parameters.norm());
}

TEST_P(EveryModel, BatchesGiveTheSameBitsAsSinglePoints) {
  const Camera camera = MakeCamera(GetParam());
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> x(0, 639), y(0, 479);
  std::vector<Eigen::Vector2d> pixels(20011);
  for (auto& q : pixels) q = {x(rng), y(rng)};
  std::vector<Eigen::Vector3d> rays(pixels.size());
  camera.Unproject(pixels, rays);
  std::vector<Eigen::Vector2d> back(pixels.size());
  camera.Project(rays, back);
  for (std::size_t i = 0; i < pixels.size(); i += 97) {
    EXPECT_EQ(rays[i], camera.Unproject(pixels[i]));
    EXPECT_EQ(back[i], camera.Project(rays[i]));
  }
}

INSTANTIATE_TEST_SUITE_P(Camera, EveryModel,
                         ::testing::Values(LensModel::Kind::kOpenCv4, LensModel::Kind::kOpenCv5,
                                           LensModel::Kind::kOpenCv8,
                                           LensModel::Kind::kSplinedStereographic),
                         ModelName);

TEST(Camera, PointsBehindItAreNaN) {
  const Camera camera = MakeCamera(LensModel::Kind::kOpenCv5);
  EXPECT_TRUE(camera.Project({1, 2, -10}).array().isNaN().all());
  EXPECT_TRUE(camera.ProjectWithJacobians({1, 2, 0}).d_pixel_d_point.array().isNaN().all());
}

TEST(Camera, PixelsBeyondAFoldAreNaNNotAWrongRay) {
  // r (1 - 0.5 r^2) has its largest value 0.544 at r = 0.816: no ray looks at pixels further out.
  Eigen::VectorXd p(8);
  p << 500, 500, 320, 240, -0.5, 0, 0, 0;
  const Camera camera(LensModel::FromName("opencv4"), {1280, 960}, p);
  EXPECT_TRUE(camera.Unproject({320 + 500 * 0.54, 240}).allFinite());
  EXPECT_FALSE(camera.Unproject({320 + 500 * 0.60, 240}).allFinite());
  EXPECT_GT(camera.NonInvertibleShare(), 0.3);
  EXPECT_EQ(MakeCamera(LensModel::Kind::kOpenCv5).NonInvertibleShare(), 0.0);
}

TEST(Camera, RefusesWhatIsNoCamera) {
  const LensModel model = LensModel::FromName("OPENCV5");
  EXPECT_THROW(Camera(model, {640, 480}, Eigen::VectorXd::Ones(8)), std::invalid_argument);
  Eigen::VectorXd p = Eigen::VectorXd::Ones(9);
  p[0] = -1;
  EXPECT_THROW(Camera(model, {640, 480}, p), std::invalid_argument);
  p[0] = std::nan("");
  EXPECT_THROW(Camera(model, {640, 480}, p), std::invalid_argument);
  EXPECT_THROW(LensModel::FromName("FISHEYE"), InputError);
}

TEST(LensModel, NamesGoThereAndBack) {
  for (const char* name : {"LENSMODEL_OPENCV4", "LENSMODEL_OPENCV8",
                           "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=11_fov_x_deg=80"}) {
    EXPECT_EQ(LensModel::FromName(name).Name(), name);
  }
  EXPECT_EQ(LensModel::FromName("opencv5").ParameterCount(), 9);
}

}  // namespace
}  // namespace plumbline
