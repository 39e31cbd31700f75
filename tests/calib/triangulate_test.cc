#include "calib/triangulate.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <random>
#include <sstream>

#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"

namespace plumbline {
namespace {

// A rig like a DIC one: 19 degrees between the axes, 123 mm apart, some distortion, unlike cameras.
StereoRig MakeRig() {
  Eigen::VectorXd p(9), q(12);
  p << 2000, 2003, 640, 480, -0.12, 0.08, 1e-3, -7e-4, 0.01;
  q << 2050, 2047, 655, 470, -0.15, 0.05, -6e-4, 8e-4, 0.02, 0.01, -0.02, 0.01;
  return {Camera(LensModel::FromName("opencv5"), {1280, 960}, p),
          Camera(LensModel::FromName("opencv8"), {1280, 960}, q),
          Rigid3::FromRotationVector({0.012, 0.33, -0.02}, {-121, 2, 20}),
          {},
          ""};
}

StereoObservation Observe(const StereoRig& rig, const Eigen::Vector3d& point_in_rig) {
  StereoObservation o;
  o.left = rig.left.Project(point_in_rig);
  o.right = rig.right.Project(rig.right_from_left * point_in_rig);
  return o;
}

// A covariance with correlation within and between the images, as DIC with a shared reference
// gives.
Eigen::Matrix4d PixelCovariance() {
  Eigen::Matrix4d L;
  L << 0.10, 0, 0, 0, 0.02, 0.12, 0, 0, 0.05, 0.01, 0.09, 0, -0.01, 0.03, 0.02, 0.11;
  return L * L.transpose();
}

std::vector<StereoObservation> ObserveMany(const StereoRig& rig, int n, double noise_px) {
  std::mt19937 rng(11);
  std::uniform_real_distribution<double> x(-60, 60), y(-50, 50), z(350, 420);
  std::normal_distribution<double> noise(0, noise_px);
  std::vector<StereoObservation> all;
  for (int i = 0; i < n; ++i) {
    all.push_back(Observe(rig, {x(rng), y(rng), z(rng)}));
    all.back().left += Eigen::Vector2d(noise(rng), noise(rng));
    all.back().right += Eigen::Vector2d(noise(rng), noise(rng));
    all.back().cov_px2 = PixelCovariance();
  }
  return all;
}

TEST(Triangulate, IsExactOnNoiseFreePixels) {
  const StereoRig rig = MakeRig();
  for (const Eigen::Vector3d& point :
       {Eigen::Vector3d(0, 0, 384), Eigen::Vector3d(40, -30, 350), Eigen::Vector3d(-55, 45, 420)}) {
    const TriangulatedPoint t = Triangulate(rig, Observe(rig, point));
    EXPECT_EQ(t.status, Status::kOk);
    EXPECT_LT((t.point_in_rig - point).norm(), 1e-8);
    EXPECT_NEAR(t.epipolar_px, 0, 1e-8);
  }
}

// The normalised error squared of a point is chi-squared of three degrees where the covariance
// holds.
TEST(Triangulate, CovarianceIsConsistent) {
  const StereoRig rig = MakeRig();
  const Eigen::Vector3d truth(31, -22, 391);
  const StereoObservation exact = Observe(rig, truth);
  const Eigen::Matrix4d L = PixelCovariance().llt().matrixL();
  std::mt19937 rng(7);
  std::normal_distribution<double> normal(0, 1);
  const int draws = 2000;
  double nees = 0;
  for (int i = 0; i < draws; ++i) {
    const Eigen::Vector4d e =
        L * Eigen::Vector4d(normal(rng), normal(rng), normal(rng), normal(rng));
    const TriangulatedPoint t =
        Triangulate(rig, {exact.left + e.head<2>(), exact.right + e.tail<2>(), PixelCovariance()});
    const Eigen::Vector3d error = t.point_in_rig - truth;
    nees += error.dot(t.cov_mm2.ldlt().solve(error)) / draws;
  }
  EXPECT_NEAR(nees, 3, 4 * std::sqrt(6.0 / draws));
}

TEST(Triangulate, EpipolarSigmaIsThatOfSampling) {
  const StereoRig rig = MakeRig();
  const StereoObservation exact = Observe(rig, {-25, 18, 402});
  const Eigen::Matrix4d L = PixelCovariance().llt().matrixL();
  std::mt19937 rng(8);
  std::normal_distribution<double> normal(0, 1);
  const int draws = 4000;
  double sum = 0, sum2 = 0;
  for (int i = 0; i < draws; ++i) {
    const Eigen::Vector4d e =
        L * Eigen::Vector4d(normal(rng), normal(rng), normal(rng), normal(rng));
    const TriangulatedPoint t =
        Triangulate(rig, {exact.left + e.head<2>(), exact.right + e.tail<2>(), PixelCovariance()});
    const double z = t.epipolar_px / t.sigma_epipolar_px;
    sum += z;
    sum2 += z * z;
  }
  EXPECT_NEAR(sum / draws, 0, 4 / std::sqrt(draws));
  EXPECT_NEAR(sum2 / draws, 1, 4 * std::sqrt(2.0 / draws));
}

// Against the definition in words: the shortest way from the right pixel to the curve that the left
// pixel's ray draws on the right image.
TEST(Triangulate, EpipolarErrorIsTheSignedDistanceFromTheEpipolarCurve) {
  const StereoRig rig = MakeRig();
  const StereoObservation exact = Observe(rig, {15, 27, 380});
  const Eigen::Vector3d ray = rig.left.Unproject(exact.left);
  for (const double offset_px : {-2.0, -0.3, 0.3, 2.0}) {
    StereoObservation o = exact;
    o.right.y() += offset_px;
    double nearest = 1e9;
    for (double depth = 300; depth < 500; depth += 0.001) {
      const Eigen::Vector2d on_curve = rig.right.Project(rig.right_from_left * (ray * depth));
      nearest = std::min(nearest, (on_curve - o.right).norm());
    }
    const double epipolar_px = Triangulate(rig, o).epipolar_px;
    EXPECT_NEAR(epipolar_px, std::copysign(nearest, offset_px), 2e-3 * std::abs(offset_px));
  }
}

TEST(Triangulate, JacobianIsThatOfFiniteDifferences) {
  const StereoRig rig = MakeRig();
  const StereoObservation exact = Observe(rig, {15, 27, 380});
  Eigen::VectorXd q(4);
  q << exact.left + Eigen::Vector2d(0.5, -0.7), exact.right + Eigen::Vector2d(-0.3, 0.6);
  const Eigen::MatrixXd J = testing::NumericJacobian(
      [&](const Eigen::VectorXd& p) -> Eigen::VectorXd {
        return Triangulate(rig, {p.head<2>(), p.tail<2>()}).point_in_rig;
      },
      q);
  const StereoObservation o{q.head<2>(), q.tail<2>(), PixelCovariance()};
  const Eigen::Matrix3d expected = J * o.cov_px2 * J.transpose();
  EXPECT_LT((Triangulate(rig, o).cov_mm2 - expected).norm(), 1e-6 * expected.norm());
}

TEST(Triangulate, ParameterJacobianIsThatOfFiniteDifferences) {
  const StereoRig rig = MakeRig();
  StereoObservation o = Observe(rig, {-35, 21, 371});
  o.right.y() += 0.8;
  const Eigen::MatrixXd J = TriangulationParameterJacobian(rig, o.left, o.right);
  const Eigen::MatrixXd numeric = testing::NumericJacobian(
      [&](const Eigen::VectorXd& p) -> Eigen::VectorXd {
        return Triangulate(rig.WithParameters(p), o).point_in_rig;
      },
      rig.Parameters(), 1e-5);
  ASSERT_EQ(J.cols(), rig.ParameterCount());
  for (Eigen::Index k = 0; k < J.cols(); ++k) {
    EXPECT_LT((J.col(k) - numeric.col(k)).norm(), 1e-5 * numeric.col(k).norm() + 1e-9) << k;
  }
}

TEST(Triangulate, ReportsParallelRays) {
  StereoRig rig = MakeRig();
  rig.right = rig.left;
  rig.right_from_left.rotation.setIdentity();
  const TriangulatedPoint t = Triangulate(rig, {{600, 400}, {600, 400}});
  EXPECT_EQ(t.status, Status::kBehindCamera);
  EXPECT_TRUE(t.point_in_rig.array().isNaN().all());
  EXPECT_TRUE(t.cov_mm2.array().isNaN().all());
  const std::vector<Eigen::Vector2d> q = {{600, 400}};
  EXPECT_TRUE(TriangulatePoints(rig, q, q)[0].array().isNaN().all());
}

TEST(Triangulate, ReportsRaysThatMeetBehindTheCameras) {
  const StereoRig rig = MakeRig();
  StereoObservation o = Observe(rig, {0, 0, 384});
  o.right.x() += 1000;  // the ray turns outwards
  const TriangulatedPoint t = Triangulate(rig, o);
  EXPECT_EQ(t.status, Status::kBehindCamera);
  EXPECT_TRUE(t.point_in_rig.array().isNaN().all());
  EXPECT_TRUE(std::isfinite(t.epipolar_px));
}

TEST(Triangulate, ReportsPixelsWithoutARay) {
  const StereoRig rig = MakeRig();
  StereoObservation o = Observe(rig, {0, 0, 384});
  o.left.x() = std::nan("");
  o.cov_px2.setConstant(std::nan(""));
  const TriangulatedPoint t = Triangulate(rig, o);
  EXPECT_EQ(t.status, Status::kOutsideImage);
  EXPECT_TRUE(std::isnan(t.epipolar_px) && std::isnan(t.sigma_epipolar_px));
}

TEST(Triangulate, RefusesWhatIsNoCovariance) {
  const StereoRig rig = MakeRig();
  StereoObservation o = Observe(rig, {0, 0, 384});
  o.cov_px2(0, 2) = 0.3;
  EXPECT_THROW((void)Triangulate(rig, o), std::invalid_argument);
  o.cov_px2(2, 0) = 0.3;
  EXPECT_NO_THROW((void)Triangulate(rig, o));
  o.cov_px2(1, 1) = std::nan("");
  EXPECT_THROW((void)Triangulate(rig, o), std::invalid_argument);
  const std::vector<StereoObservation> some = {Observe(rig, {0, 0, 384}), o};
  try {
    (void)Triangulate(rig, some);
    FAIL() << "accepted a NaN covariance";
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("observation 1"), std::string::npos);
  }
  const std::vector<Eigen::Vector2d> one(1), two(2);
  EXPECT_THROW((void)TriangulatePoints(rig, one, two), std::invalid_argument);
}

TEST(Triangulate, GivesTheSameBitsForAnyNumberOfThreads) {
  const StereoRig rig = MakeRig();
  const std::vector<StereoObservation> all = ObserveMany(rig, 5003, 0.2);
  std::vector<Eigen::Vector2d> left, right;
  for (const StereoObservation& o : all) {
    left.push_back(o.left);
    right.push_back(o.right);
  }
  std::vector<TriangulatedPoint> one_thread;
  {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
    one_thread = Triangulate(rig, all);
  }
  const auto many_threads = Triangulate(rig, all);
  const auto points = TriangulatePoints(rig, left, right);
  for (std::size_t i = 0; i < all.size(); ++i) {
    ASSERT_EQ(one_thread[i].point_in_rig, many_threads[i].point_in_rig);
    ASSERT_EQ(one_thread[i].cov_mm2, many_threads[i].cov_mm2);
    ASSERT_EQ(one_thread[i].point_in_rig, points[i]);
    if (i % 500 == 0) {
      ASSERT_EQ(Triangulate(rig, all[i]).cov_mm2, one_thread[i].cov_mm2);
    }
  }
}

// mrcal's own midpoint, with its gradients, from its own unprojection of the same pixels.
TEST(Triangulate, AgreesWithMrcal) {
  const StereoRig rig = MakeRig();
  const std::vector<StereoObservation> all = ObserveMany(rig, 50, 0.3);
  const auto list = [](const Eigen::VectorXd& v) {
    std::ostringstream text;
    text << std::setprecision(17) << "np.array((";
    for (const double x : v) text << x << ",";
    return text.str() + "))";
  };
  std::ostringstream script;
  script << "import numpy as np, numpysane as nps, mrcal\n"
         << "left=('LENSMODEL_OPENCV5'," << list(rig.left.parameters()) << ")\n"
         << "right=('LENSMODEL_OPENCV8'," << list(rig.right.parameters()) << ")\n"
         << "rt=" << list(rig.Parameters().tail<6>()) << "\n"
         << "Rt01=mrcal.invert_Rt(mrcal.Rt_from_rt(rt))\n"
         << "S=" << list(Eigen::Map<const Eigen::VectorXd>(all[0].cov_px2.data(), 16))
         << ".reshape(4,4)\n"
         << "def G(v,m):\n"
         << "  g=mrcal.project(v,*m,get_gradients=True)[1]\n"
         << "  return g.T @ np.linalg.inv(g @ g.T)\n"
         << "for a,b,c,d in (";
  script << std::setprecision(17);
  for (const StereoObservation& o : all) {
    script << "(" << o.left.x() << "," << o.left.y() << "," << o.right.x() << "," << o.right.y()
           << "),";
  }
  script << "):\n"
         << "  v0=mrcal.unproject(np.array((a,b)),*left,normalize=True)\n"
         << "  v1=mrcal.unproject(np.array((c,d)),*right,normalize=True)\n"
         << "  v1r=mrcal.rotate_point_R(Rt01[:3],v1)\n"
         << "  m,dv0,dv1,dt=mrcal.triangulate_geometric(v0,v1r,Rt01[3],get_gradients=True)\n"
         << "  J=np.hstack((dv0@G(v0,left),dv1@Rt01[:3]@G(v1,right)))\n"
         << "  print(*m,*(J@S@J.T).ravel())\n";
  const auto python = testing::RunPython(script.str());
  ASSERT_EQ(python.exit_code, 0) << python.output;
  std::istringstream lines(python.output);
  for (const StereoObservation& o : all) {
    Eigen::Vector3d point;
    Eigen::Matrix3d cov;
    for (double& x : point) ASSERT_TRUE(lines >> x) << python.output;
    for (int i = 0; i < 9; ++i) ASSERT_TRUE(lines >> cov(i / 3, i % 3));
    const TriangulatedPoint t = Triangulate(rig, o);
    // mrcal's unproject stops at about 1e-7 px.
    EXPECT_LT((t.point_in_rig - point).norm(), 1e-5);
    EXPECT_LT((t.cov_mm2 - cov).norm(), 1e-6 * cov.norm());
  }
}

}  // namespace
}  // namespace plumbline
