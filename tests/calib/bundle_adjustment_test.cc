#include "calib/bundle_adjustment.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <random>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

constexpr double kNoise_px = 0.1;

Camera MakeCamera(double shift) {
  Eigen::VectorXd p(8);
  p << 1000 + shift, 1003 + shift, 320, 240, -0.1, 0.05, 1e-3, -5e-4;
  return Camera(LensModel::FromName("opencv4"), {640, 480}, p);
}

// Two cameras and a rigid cloud of points that moves; motions: right_from_left, then one a frame.
struct Scene {
  BundleProblem truth;
  static constexpr int kFrames = 4;

  explicit Scene(int points = 25) {
    truth.cameras = {{MakeCamera(0), true}, {MakeCamera(7), true}};
    truth.motions.push_back({Rigid3::FromRotationVector({0.01, 0.3, -0.02}, {-110, 2, 15})});
    std::mt19937 rng(2);
    std::uniform_real_distribution<double> u(-1, 1);
    for (int f = 0; f < kFrames; ++f) {
      truth.motions.push_back(
          {Rigid3::FromRotationVector({0.3 * u(rng), 0.3 * u(rng), 0.2 * u(rng)},
                                      {5 * u(rng), 5 * u(rng), 380 + 20 * u(rng)})});
    }
    truth.motions[1].fixed = true;
    for (int p = 0; p < points; ++p) {
      truth.points.push_back({{50 * u(rng), 40 * u(rng), 15 * u(rng)}});
    }
    for (int f = 0; f < kFrames; ++f) {
      for (int c = 0; c < 2; ++c) {
        for (int p = 0; p < points; ++p) {
          BundleObservation o;
          o.camera = c;
          o.camera_from_rig = c == 0 ? -1 : 0;
          o.rig_from_frame = 1 + f;
          o.point = p;
          o.cov_px2 = Eigen::Matrix2d::Identity() * kNoise_px * kNoise_px;
          const Eigen::Vector3d in_rig = truth.motions[static_cast<std::size_t>(1 + f)].motion *
                                         truth.points[static_cast<std::size_t>(p)].point_mm;
          o.pixel = truth.cameras[static_cast<std::size_t>(c)].camera.Project(
              c == 0 ? in_rig : truth.motions[0].motion * in_rig);
          truth.observations.push_back(o);
        }
      }
    }
    truth.distances = {{0, 1, Length(truth), 1e-3}};
  }

  static double Length(const BundleProblem& problem) {
    return (problem.points[0].point_mm - problem.points[1].point_mm).norm();
  }

  // The scene as somebody would start it: noisy pixels, motions and points somewhat off.
  BundleProblem Noisy(unsigned seed, double start_error = 1) const {
    BundleProblem problem = truth;
    std::mt19937 rng(seed);
    std::normal_distribution<double> n(0, 1);
    for (auto& o : problem.observations) o.pixel += kNoise_px * Eigen::Vector2d(n(rng), n(rng));
    for (auto& d : problem.distances) d.distance_mm += d.sigma_mm * n(rng);
    for (auto& m : problem.motions) {
      if (m.fixed) continue;
      m.motion.translation_mm += start_error * Eigen::Vector3d(n(rng), n(rng), n(rng));
      m.motion =
          Rigid3::FromRotationVector(start_error * 0.005 * Eigen::Vector3d(n(rng), n(rng), n(rng)),
                                     Eigen::Vector3d::Zero()) *
          m.motion;
    }
    for (auto& p : problem.points) {
      if (!p.fixed) p.point_mm += start_error * Eigen::Vector3d(n(rng), n(rng), n(rng));
    }
    return problem;
  }
};

TEST(AdjustBundle, RecoversANoisyScene) {
  const Scene scene;
  const BundleResult r = AdjustBundle(scene.Noisy(1));
  EXPECT_TRUE(r.converged);
  EXPECT_NEAR(r.sigma0, 1, 4 / std::sqrt(2.0 * r.degrees_of_freedom));
  for (std::size_t p = 0; p < scene.truth.points.size(); ++p) {
    const Eigen::Vector3d error = r.solved.points[p].point_mm - scene.truth.points[p].point_mm;
    const std::vector<BundleBlock> block = {BundleBlock::Point(static_cast<int>(p))};
    EXPECT_LT(error.dot(r.Covariance(block).ldlt().solve(error)), 25) << p;
  }
}

// Normalised error squared of a joint block, over repeated noise.
TEST(AdjustBundle, CovarianceIsConsistentWithSampling) {
  const Scene scene(12);
  const std::vector<BundleBlock> blocks = {BundleBlock::Motion(0), BundleBlock::Point(0),
                                           BundleBlock::Point(5), BundleBlock::Motion(2)};
  const int draws = 150, size = 18;
  double nees = 0;
  for (int i = 0; i < draws; ++i) {
    const BundleResult r = AdjustBundle(scene.Noisy(static_cast<unsigned>(100 + i), 0.1));
    Eigen::VectorXd error(size);
    const auto motion_error = [&](std::size_t k) {
      Eigen::Matrix<double, 6, 1> e;
      e << r.solved.motions[k].motion.RotationVector() -
               scene.truth.motions[k].motion.RotationVector(),
          r.solved.motions[k].motion.translation_mm - scene.truth.motions[k].motion.translation_mm;
      return e;
    };
    error << motion_error(0), r.solved.points[0].point_mm - scene.truth.points[0].point_mm,
        r.solved.points[5].point_mm - scene.truth.points[5].point_mm, motion_error(2);
    nees += error.dot(r.Covariance(blocks).ldlt().solve(error)) / draws;
  }
  EXPECT_NEAR(nees, size, 4 * std::sqrt(2.0 * size / draws));
}

// Against the inverse of J'J of everything at once, J by finite differences.
TEST(AdjustBundle, CovarianceIsThatOfTheWholeNormalMatrix) {
  const Scene scene(8);
  const BundleResult r = AdjustBundle(scene.Noisy(9));
  const BundleProblem& at = r.solved;
  std::vector<BundleBlock> blocks;
  std::vector<double> values;
  for (int m = 0; m < static_cast<int>(at.motions.size()); ++m) {
    const BundleMotion& motion = at.motions[static_cast<std::size_t>(m)];
    if (motion.fixed) continue;
    blocks.push_back(BundleBlock::Motion(m));
    for (const double v : motion.motion.RotationVector()) values.push_back(v);
    for (const double v : motion.motion.translation_mm) values.push_back(v);
  }
  for (int p = 0; p < static_cast<int>(at.points.size()); ++p) {
    blocks.push_back(BundleBlock::Point(p));
    for (const double v : at.points[static_cast<std::size_t>(p)].point_mm) values.push_back(v);
  }
  const auto residuals = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    BundleProblem moved = at;
    Eigen::Index i = 0;
    for (const BundleBlock& b : blocks) {
      const auto k = static_cast<std::size_t>(b.index);
      if (b.kind == BundleBlock::Kind::kMotion) {
        moved.motions[k].motion = Rigid3::FromRotationVector(x.segment<3>(i), x.segment<3>(i + 3));
        i += 6;
      } else {
        moved.points[k].point_mm = x.segment<3>(i);
        i += 3;
      }
    }
    std::vector<double> out;
    for (const BundleObservation& o : at.observations) {
      Eigen::Vector3d p = moved.motions[static_cast<std::size_t>(o.rig_from_frame)].motion *
                          moved.points[static_cast<std::size_t>(o.point)].point_mm;
      if (o.camera_from_rig >= 0) p = moved.motions[0].motion * p;
      const Eigen::Vector2d q = at.cameras[static_cast<std::size_t>(o.camera)].camera.Project(p);
      out.push_back(q.x() / kNoise_px);
      out.push_back(q.y() / kNoise_px);
    }
    out.push_back(Scene::Length(moved) / moved.distances[0].sigma_mm);
    return Eigen::Map<Eigen::VectorXd>(out.data(), static_cast<Eigen::Index>(out.size()));
  };
  const Eigen::VectorXd x =
      Eigen::Map<Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  const Eigen::MatrixXd J = testing::NumericJacobian(residuals, x);
  const Eigen::MatrixXd expected = (J.transpose() * J).inverse();
  const Eigen::MatrixXd cov = r.Covariance(blocks);
  ASSERT_EQ(cov.rows(), expected.rows());
  const Eigen::VectorXd sigma = expected.diagonal().cwiseSqrt().cwiseInverse();
  EXPECT_LT((sigma.asDiagonal() * (cov - expected) * sigma.asDiagonal()).cwiseAbs().maxCoeff(),
            1e-4);
  EXPECT_LT((r.Covariance(blocks, true) - cov * r.sigma0 * r.sigma0).norm(), 1e-9 * cov.norm());
}

TEST(AdjustBundle, HoldsFixedPartsToTheBit) {
  const Scene scene;
  BundleProblem problem = scene.Noisy(3);
  problem.points[4].fixed = true;
  problem.cameras[1].fixed = false;
  const BundleResult r = AdjustBundle(problem);
  EXPECT_EQ(r.solved.points[4].point_mm, problem.points[4].point_mm);
  EXPECT_EQ(r.solved.motions[1].motion.rotation, problem.motions[1].motion.rotation);
  EXPECT_EQ(r.solved.cameras[0].camera.parameters(), problem.cameras[0].camera.parameters());
  EXPECT_NE(r.solved.cameras[1].camera.parameters(), problem.cameras[1].camera.parameters());
  const std::vector<BundleBlock> fixed = {BundleBlock::Point(4), BundleBlock::Motion(1)};
  EXPECT_EQ(r.Covariance(fixed).norm(), 0);
}

TEST(AdjustBundle, AKnownDistanceSetsTheScale) {
  BundleProblem problem = Scene().Noisy(4);
  problem.distances[0].distance_mm = 1.01 * Scene::Length(Scene().truth);
  const BundleResult r = AdjustBundle(problem);
  EXPECT_NEAR(Scene::Length(r.solved), problem.distances[0].distance_mm, 3e-3);
}

TEST(AdjustBundle, RobustLossSurvivesOutliers) {
  const Scene scene;
  BundleProblem problem = scene.Noisy(5);
  for (std::size_t i = 3; i < problem.observations.size(); i += 20) {
    problem.observations[i].pixel += Eigen::Vector2d(15, -9);
  }
  BundleOptions robust;
  robust.loss = BundleLoss::kCauchy;
  const auto error = [&](const BundleOptions& options, double* outlier_weight) {
    const BundleResult r = AdjustBundle(problem, options);
    *outlier_weight = r.weights[3];
    return (r.solved.motions[0].motion.translation_mm -
            scene.truth.motions[0].motion.translation_mm)
        .norm();
  };
  double weight = 0, square_weight = 0;
  const double robust_error = error(robust, &weight);
  EXPECT_LT(robust_error, 0.2 * error({}, &square_weight));
  EXPECT_LT(weight, 0.01);
  EXPECT_EQ(square_weight, 1);
}

TEST(AdjustBundle, NamesWhatIsNotConstrained) {
  const auto message = [](const BundleProblem& problem) -> std::string {
    try {
      (void)AdjustBundle(problem);
    } catch (const InputError& error) {
      return error.what();
    }
    return "accepted";
  };
  BundleProblem problem = Scene().Noisy(6);
  problem.distances.clear();
  EXPECT_NE(message(problem).find("1 directions"), std::string::npos) << message(problem);
  EXPECT_NE(message(problem).find("translation of motion"), std::string::npos);
  problem = Scene().Noisy(6);
  problem.motions.push_back({});
  EXPECT_NE(message(problem).find("motion 5"), std::string::npos) << message(problem);
  problem = Scene().Noisy(6);
  problem.points.push_back({{1, 2, 3}});
  BundleObservation lone = problem.observations[0];
  lone.point = static_cast<int>(problem.points.size()) - 1;
  problem.observations.push_back(lone);
  EXPECT_NE(message(problem).find("point 25"), std::string::npos) << message(problem);
}

TEST(AdjustBundle, MinimalPriorHoldsTheGaugeWithoutTouchingResiduals) {
  BundleProblem problem = Scene().Noisy(7, 0.2);
  const BundleResult given = AdjustBundle(problem);
  problem.distances.clear();
  problem.motions[1].fixed = false;
  BundleOptions options;
  options.gauge = BundleGauge::kMinimalPrior;
  const BundleResult r = AdjustBundle(problem, options);
  EXPECT_EQ(r.gauge_directions, 7);
  for (std::size_t i = 0; i < given.residuals_px.size(); i += 11) {
    EXPECT_LT((r.residuals_px[i] - given.residuals_px[i]).norm(), 1e-5);
  }
}

TEST(AdjustBundle, RefusesNonsense) {
  BundleProblem problem = Scene().Noisy(8);
  problem.observations[3].cov_px2(0, 0) = -1;
  EXPECT_THROW((void)AdjustBundle(problem), std::invalid_argument);
  problem = Scene().Noisy(8);
  problem.observations[3].point = 99;
  EXPECT_THROW((void)AdjustBundle(problem), std::invalid_argument);
  problem = Scene().Noisy(8);
  problem.points[3].point_mm.z() = -2000;
  EXPECT_THROW((void)AdjustBundle(problem), InputError);
  BundleOptions options;
  options.loss_scale_sigmas = 0;
  EXPECT_THROW((void)AdjustBundle(Scene().Noisy(8), options), UsageError);
}

}  // namespace
}  // namespace plumbline
