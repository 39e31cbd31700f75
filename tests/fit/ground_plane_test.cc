#include "fit/ground_plane.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <random>
#include <sstream>

#include "calib/error.h"
#include "fit/internal/plane_refinement.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

using testing::NumericJacobian;

struct Scene {
  Eigen::Vector3d normal = Eigen::Vector3d(0.1, -0.3, -1).normalized();
  Eigen::Vector3d centre = Eigen::Vector3d(20, -10, 400);
  double half_mm = 60;
  // Stereo points: ten times surer across the ray than along it, and not the same everywhere.
  Eigen::Matrix3d CovarianceAt(double x) const {
    const Eigen::Vector3d s(0.004, 0.006, 0.04 * (1 + 0.5 * x));
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(0.4, Eigen::Vector3d(0.3, 1, 0).normalized()).toRotationMatrix();
    return turn * s.cwiseAbs2().asDiagonal() * turn.transpose();
  }
};

struct Cloud {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Matrix3d> cov;
};

// `shared`: so many points, side by side within 2 mm, get the same noise.
Cloud DrawPlane(const Scene& scene, int count, std::uint64_t seed, int shared = 1,
                double noise_factor = 1) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  std::normal_distribution<double> gauss;
  const auto basis = internal::MakeLocalPlane(scene.normal, scene.centre);
  Cloud cloud;
  double x = 0;
  double y = 0;
  Eigen::Vector3d unit_noise = Eigen::Vector3d::Zero();
  for (int i = 0; i < count; ++i) {
    if (i % shared == 0) {
      x = uniform(random);
      y = uniform(random);
      unit_noise = Eigen::Vector3d(gauss(random), gauss(random), gauss(random));
    }
    const Eigen::Matrix3d C = scene.CovarianceAt(x);
    const Eigen::Matrix3d L = C.llt().matrixL();
    const Eigen::Vector3d beside = uniform(random) * basis.e1 + uniform(random) * basis.e2;
    cloud.points.push_back(scene.centre + scene.half_mm * (x * basis.e1 + y * basis.e2) + beside +
                           noise_factor * L * unit_noise);
    cloud.cov.push_back(C);
  }
  return cloud;
}

GroundPlane TruePlane(const Scene& scene) {
  GroundPlane plane;
  plane.normal = scene.normal;
  plane.offset_mm = scene.normal.dot(scene.centre);
  return plane;
}

double Nees(const GroundPlane& fitted, const GroundPlane& truth) {
  const Eigen::Vector3d error = PlaneDifference(fitted, truth);
  return error.dot(fitted.cov.inverse() * error);
}

std::string ReasonFor(const Cloud& cloud, const GroundPlaneOptions& options = {}) {
  try {
    const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov, options);
    ADD_FAILURE() << "accepted with rms " << plane.rms_mm << " mm, inliers "
                  << plane.inlier_fraction;
  } catch (const InputError& error) {
    return error.what();
  }
  return {};
}

TEST(GroundPlane, ResidualDerivativeMatchesFiniteDifferences) {
  const Scene scene;
  const auto plane = internal::MakeLocalPlane(scene.normal, scene.centre);
  const Eigen::Vector3d point = scene.centre + Eigen::Vector3d(30, -25, 7);
  const Eigen::Matrix3d C = scene.CovarianceAt(0.3);
  const auto whitened = [&](const Eigen::VectorXd& step) -> Eigen::VectorXd {
    const auto r = internal::EvaluatePlaneResidual(plane.Moved(step), point, C, 0);
    return Eigen::VectorXd::Constant(1, r.whitened);
  };
  const auto analytic = internal::EvaluatePlaneResidual(plane, point, C, 0);
  const Eigen::MatrixXd numeric = NumericJacobian(whitened, Eigen::Vector3d::Zero(), 1e-5);
  EXPECT_LT((analytic.d_whitened_d_step.transpose() - numeric).norm(), 1e-7 * numeric.norm());
}

TEST(GroundPlane, DifferenceIsTheStepThatMovesThePlane) {
  const Scene scene;
  const auto local = internal::MakeLocalPlane(scene.normal, scene.centre);
  GroundPlane reference = TruePlane(scene);
  reference.centroid = local.centroid;
  reference.e1 = local.e1;
  reference.e2 = local.e2;
  const Eigen::Vector3d step(0.01, -0.02, 0.3);
  const auto moved = local.Moved(step);
  GroundPlane other;
  other.normal = moved.normal;
  other.offset_mm = moved.normal.dot(moved.centroid);
  EXPECT_LT((PlaneDifference(reference, other) - step).norm(), 1e-12);
}

TEST(GroundPlane, FindsAnExactPlaneAndLooksBackAtTheRig) {
  Scene scene;
  for (const double flip : {1.0, -1.0}) {
    scene.normal *= flip;
    Cloud cloud = DrawPlane(scene, 500, 3, 1, 0.0);
    const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
    EXPECT_LT(plane.normal.z(), 0);
    EXPECT_LT(plane.offset_mm, 0);
    EXPECT_NEAR(std::abs(plane.normal.dot(scene.normal)), 1, 1e-12);
    EXPECT_NEAR(plane.SignedDistance(scene.centre), 0, 1e-9);
    EXPECT_EQ(plane.inlier_fraction, 1);
    EXPECT_NEAR(plane.e1.cross(plane.e2).dot(plane.normal), 1, 1e-12);
  }
}

TEST(GroundPlane, RandomCovarianceIsConsistent) {
  const Scene scene;
  const GroundPlane truth = TruePlane(scene);
  const int draws = 400;
  double nees = 0;
  double ratio = 0;
  for (int k = 0; k < draws; ++k) {
    const Cloud cloud = DrawPlane(scene, 300, 100 + static_cast<std::uint64_t>(k));
    const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
    nees += Nees(plane, truth) / draws;
    ratio += plane.scatter_ratio / draws;
  }
  EXPECT_NEAR(nees, 3, 4 * std::sqrt(6.0 / draws));
  EXPECT_NEAR(ratio, 1, 0.05);
}

TEST(GroundPlane, CovarianceGrowsWithScatterThatTheSigmasDoNotExplain) {
  const Scene scene;
  const GroundPlane truth = TruePlane(scene);
  const int draws = 300;
  double nees = 0;
  for (int k = 0; k < draws; ++k) {
    const Cloud cloud = DrawPlane(scene, 300, 900 + static_cast<std::uint64_t>(k), 1, 4.0);
    const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
    nees += Nees(plane, truth) / draws;
    EXPECT_NEAR(plane.scatter_ratio, 4, 0.8);
  }
  EXPECT_NEAR(nees, 3, 4 * std::sqrt(6.0 / draws));
}

TEST(GroundPlane, CovarianceCountsNoiseSharedByNeighbours) {
  const Scene scene;
  const GroundPlane truth = TruePlane(scene);
  const int draws = 300;
  double independent = 0;
  double counted = 0;
  GroundPlaneOptions options;
  for (int k = 0; k < draws; ++k) {
    const Cloud cloud = DrawPlane(scene, 2500, 500 + static_cast<std::uint64_t>(k), 25);
    options.correlation_area_points = 25;
    counted += Nees(FitGroundPlane(cloud.points, cloud.cov, options), truth) / draws;
    options.correlation_area_points = 1;
    independent += Nees(FitGroundPlane(cloud.points, cloud.cov, options), truth) / draws;
  }
  EXPECT_NEAR(counted, 3, 4 * std::sqrt(6.0 / draws));
  EXPECT_GT(independent, 50);
}

TEST(GroundPlane, OutliersAreLeftOutAndDoNotPull) {
  const Scene scene;
  Cloud cloud = DrawPlane(scene, 4000, 7);
  std::mt19937_64 random(8);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (std::size_t i = 0; i < 2000; ++i) {
    cloud.points[2 * i] -= Eigen::Vector3d(0, 0, 5 + 15 * std::abs(uniform(random)));
  }
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
  EXPECT_NEAR(plane.inlier_fraction, 0.5, 0.01);
  EXPECT_LT(Nees(plane, TruePlane(scene)), 20);
  for (std::size_t i = 0; i < 2000; ++i) EXPECT_EQ(plane.inlier[2 * i], 0);
}

TEST(GroundPlane, InvalidPointsAreLeftOut) {
  const Scene scene;
  Cloud cloud = DrawPlane(scene, 1000, 9);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = 0; i < 600; ++i) cloud.points[i] = Eigen::Vector3d::Constant(nan);
  cloud.cov[700] = Eigen::Matrix3d::Constant(nan);
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
  EXPECT_GT(plane.inlier_fraction, 0.97);
  EXPECT_EQ(plane.inlier[0], 0);
  EXPECT_EQ(plane.inlier[700], 0);
}

TEST(GroundPlane, SameResultForAnyNumberOfThreadsAndOfRuns) {
  const Scene scene;
  Cloud cloud = DrawPlane(scene, 120000, 11);
  for (std::size_t i = 0; i < 30000; ++i) cloud.points[i * 3].z() -= 10;
  std::vector<GroundPlane> planes;
  for (const std::size_t threads : {1UL, 2UL, 7UL, 1UL}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    planes.push_back(FitGroundPlane(cloud.points, cloud.cov));
  }
  for (const GroundPlane& plane : planes) {
    EXPECT_EQ(plane.normal, planes[0].normal);
    EXPECT_EQ(plane.offset_mm, planes[0].offset_mm);
    EXPECT_EQ(plane.cov, planes[0].cov);
    EXPECT_EQ(plane.inlier, planes[0].inlier);
  }
}

TEST(GroundPlane, RefitWithItsOwnInliersGivesTheSamePlane) {
  const Scene scene;
  Cloud cloud = DrawPlane(scene, 3000, 13);
  for (std::size_t i = 0; i < 500; ++i) cloud.points[i * 5].z() -= 10;
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
  const GroundPlane again = RefitPlane(cloud.points, cloud.cov, plane.inlier);
  const Eigen::Vector3d difference = PlaneDifference(plane, again);
  EXPECT_LT(difference.dot(plane.cov.inverse() * difference), 1e-10);
  EXPECT_NEAR(again.inlier_fraction, plane.inlier_fraction, 1e-12);
  EXPECT_NEAR(again.rms_mm, plane.rms_mm, 1e-9);
}

TEST(GroundPlane, RefusesTooFewPoints) {
  const Cloud cloud = DrawPlane(Scene{}, 12, 1);
  EXPECT_NE(ReasonFor(cloud).find("12 points are valid and 20 are needed"), std::string::npos);
}

TEST(GroundPlane, RefusesPointsAlongALine) {
  std::mt19937_64 random(2);
  std::normal_distribution<double> gauss;
  Cloud exact, noisy;
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d point = Eigen::Vector3d(0.5 * i, 0.2 * i, 400);
    exact.points.push_back(point);
    exact.cov.push_back(1e-4 * Eigen::Matrix3d::Identity());
    noisy.points.push_back(point +
                           0.01 * Eigen::Vector3d(gauss(random), gauss(random), gauss(random)));
    noisy.cov.push_back(1e-4 * Eigen::Matrix3d::Identity());
  }
  EXPECT_NE(ReasonFor(exact).find("line"), std::string::npos);
  EXPECT_NE(ReasonFor(noisy).find("line"), std::string::npos);
}

TEST(GroundPlane, RefusesACloudWithoutAPlane) {
  std::mt19937_64 random(2);
  std::normal_distribution<double> gauss;
  Cloud cloud;
  for (int i = 0; i < 3000; ++i) {
    cloud.points.emplace_back(30 * gauss(random), 30 * gauss(random), 400 + 30 * gauss(random));
    cloud.cov.push_back(1e-4 * Eigen::Matrix3d::Identity());
  }
  EXPECT_NE(ReasonFor(cloud).find("% are needed"), std::string::npos);
}

// A cylinder cap of this radius, 120 mm wide, with noise of 0.02 mm.
Cloud DrawCylinder(double radius_mm) {
  std::mt19937_64 random(21);
  std::uniform_real_distribution<double> uniform(-60, 60);
  std::normal_distribution<double> gauss(0, 0.02);
  Cloud cloud;
  for (int i = 0; i < 5000; ++i) {
    const double x = uniform(random);
    cloud.points.emplace_back(
        x, uniform(random),
        400 - std::sqrt(radius_mm * radius_mm - x * x) + radius_mm + gauss(random));
    cloud.cov.push_back(4e-4 * Eigen::Matrix3d::Identity());
  }
  return cloud;
}

TEST(GroundPlane, RefusesACurvedSurfaceButNotAGentlyBowedPlate) {
  EXPECT_NE(ReasonFor(DrawCylinder(150)).find("curved"), std::string::npos);
  const Cloud bowed = DrawCylinder(3600);  // 0.5 mm over 120 mm
  const GroundPlane plane = FitGroundPlane(bowed.points, bowed.cov);
  EXPECT_GT(plane.inlier_fraction, 0.95);
  EXPECT_GT(plane.scatter_ratio, 3);
}

TEST(GroundPlane, OptionsNameTheBrokenConstraint) {
  const Cloud cloud = DrawPlane(Scene{}, 100, 1);
  GroundPlaneOptions options;
  options.min_inlier_fraction = 1.5;
  EXPECT_THROW(static_cast<void>(FitGroundPlane(cloud.points, cloud.cov, options)), UsageError);
  options = {};
  options.correlation_area_points = 0.5;
  EXPECT_THROW(options.Check(), UsageError);
  options = {};
  options.inlier_threshold_mm = -1;
  EXPECT_THROW(options.Check(), UsageError);
}

TEST(GroundPlane, GroundFrameHasItsAxesWhereTheyBelong) {
  const Scene scene;
  GroundPlane plane = TruePlane(scene);
  const Eigen::Vector3d travel(1, 0.2, 0.4);
  const Eigen::Vector3d above = scene.centre + 100 * plane.normal + Eigen::Vector3d(3, 4, 0);
  const Rigid3 ground = GroundFromRig(plane, travel, above);
  EXPECT_NEAR(ground.rotation.determinant(), 1, 1e-12);
  EXPECT_LT((ground.rotation * plane.normal - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  const Eigen::Vector3d travel_in_ground = ground.rotation * travel;
  EXPECT_GT(travel_in_ground.x(), 0);
  EXPECT_NEAR(travel_in_ground.y(), 0, 1e-12);
  EXPECT_LT((ground * above).head<2>().norm(), 1e-10);
  EXPECT_NEAR((ground * scene.centre).z(), 0, 1e-10);
  EXPECT_GT((ground * Eigen::Vector3d::Zero().eval()).z(), 0);  // the camera is above
}

TEST(GroundPlane, GroundFrameFallsBackToTheRigsAxes) {
  GroundPlane plane = TruePlane(Scene{});
  const Rigid3 ground = GroundFromRig(plane, Eigen::Vector3d::Zero(), Scene{}.centre);
  EXPECT_GT((ground.rotation * Eigen::Vector3d::UnitX()).x(), 0.9);
  EXPECT_THROW(GroundFromRig(plane, plane.normal, Scene{}.centre), InputError);
  plane.normal = -Eigen::Vector3d::UnitX();
  plane.offset_mm = -100;
  const Rigid3 wall = GroundFromRig(plane, Eigen::Vector3d::Zero(), {100, 0, 0});
  EXPECT_NEAR((wall.rotation * Eigen::Vector3d::UnitY()).x(), 1, 1e-12);
}

TEST(GroundPlane, FitsTwoMillionPoints) {
  const Cloud small = DrawPlane(Scene{}, 50000, 17);
  Cloud cloud;
  for (int copy = 0; copy < 40; ++copy) {
    cloud.points.insert(cloud.points.end(), small.points.begin(), small.points.end());
    cloud.cov.insert(cloud.cov.end(), small.cov.begin(), small.cov.end());
  }
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
  const GroundPlane few = FitGroundPlane(small.points, small.cov);
  EXPECT_GT(plane.inlier_fraction, 0.99);
  EXPECT_LT(std::acos(std::min(1.0, plane.normal.dot(few.normal))), 1e-4);
}

// --- Real clouds -----------------------------------------------------------------------------

Cloud WithSigma(std::vector<Eigen::Vector3d> points, double sigma_mm) {
  Cloud cloud;
  cloud.cov.assign(points.size(), sigma_mm * sigma_mm * Eigen::Matrix3d::Identity());
  cloud.points = std::move(points);
  return cloud;
}

TEST(GroundPlane, AgreesWithPclOnItsOwnCloud) {
  PLUMBLINE_SHARED_DATA(folder, "pointcloud-planes-terrain");
  std::ifstream file(folder / "sac_plane_test.pcd");
  std::vector<Eigen::Vector3d> points;
  std::string line;
  while (std::getline(file, line) && line.rfind("DATA", 0) != 0) {
  }
  while (std::getline(file, line)) {
    std::istringstream words(line);
    Eigen::Vector3d p;
    if (words >> p.x() >> p.y() >> p.z()) points.push_back(1000 * p);
  }
  ASSERT_EQ(points.size(), 3283U);
  const Cloud cloud = WithSigma(points, 5);
  GroundPlaneOptions options;
  options.inlier_threshold_mm = 30;
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov, options);
  const Eigen::Vector3d ratios = -plane.normal / plane.offset_mm * 1000;  // PCL's (a, b, c) / d
  EXPECT_LT((ratios - Eigen::Vector3d(-0.8964, -0.5868, -1.208)).cwiseAbs().maxCoeff(), 0.01);
  EXPECT_GE(plane.inlier_fraction * 3283, 2000);
}

std::vector<Eigen::Vector3d> ReadFloatPly(const std::filesystem::path& path, std::size_t stride) {
  std::ifstream file(path, std::ios::binary);
  std::string line;
  std::size_t count = 0;
  while (std::getline(file, line) && line != "end_header") {
    if (line.rfind("element vertex ", 0) == 0) count = std::stoul(line.substr(15));
  }
  std::vector<Eigen::Vector3d> points(count);
  std::vector<char> record(stride);
  for (Eigen::Vector3d& point : points) {
    file.read(record.data(), static_cast<std::streamsize>(stride));
    float xyz[3];
    std::memcpy(xyz, record.data(), sizeof xyz);
    point = Eigen::Vector3d(xyz[0], xyz[1], xyz[2]);
  }
  return points;
}

TEST(GroundPlane, FindsTheTableUnderTheMugWithoutAThreshold) {
  PLUMBLINE_SHARED_DATA(folder, "pointcloud-planes-terrain");
  std::vector<Eigen::Vector3d> points =
      ReadFloatPly(folder / "table_scene_mug_stereo_half.ply", 12);
  ASSERT_EQ(points.size(), 104640U);
  for (Eigen::Vector3d& point : points) point *= 1000;
  const Cloud cloud = WithSigma(points, 1);
  const GroundPlane plane = FitGroundPlane(cloud.points, cloud.cov);
  EXPECT_GT(std::abs(plane.normal.dot(Eigen::Vector3d(-0.0162, 0.8378, 0.5458))), std::cos(0.01));
  EXPECT_NEAR(-plane.offset_mm, 528.6, 5);
  EXPECT_NEAR(plane.rms_mm, 1.16, 0.4);
  EXPECT_NEAR(plane.inlier_fraction * 104640, 62012, 5000);
}

TEST(GroundPlane, RefusesHillyTerrain) {
  PLUMBLINE_SHARED_DATA(folder, "pointcloud-planes-terrain");
  const Cloud cloud = WithSigma(ReadFloatPly(folder / "autzen_trim_third.ply", 13), 0.1);
  ASSERT_EQ(cloud.points.size(), 36667U);
  GroundPlaneOptions options;
  options.inlier_threshold_mm = 0.3;  // feet here: what the laser scanner's noise would allow
  EXPECT_NE(ReasonFor(cloud, options).find("are needed"), std::string::npos);
}

}  // namespace
}  // namespace plumbline
