#include "calib/relative_pose.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "calib/bundle_adjustment.h"
#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Observations = std::vector<StereoObservation>;

constexpr double kNoise_px = 0.01;
constexpr double kRad = std::numbers::pi / 180;

// Twenty degrees between the axes, which meet 500 mm away.
StereoRig MakeRig() {
  Eigen::VectorXd p(9), q(9);
  p << 2500, 2503, 640, 512, -0.12, 0.15, 1e-3, -7e-4, 0.02;
  q << 2512, 2510, 655, 498, -0.15, 0.12, -6e-4, 8e-4, -0.03;
  const LensModel model = LensModel::FromName("opencv5");
  return {Camera(model, {1280, 1024}, p),
          Camera(model, {1280, 1024}, q),
          Rigid3::FromRotationVector({0.01, 20 * kRad, -0.015}, {-171, 2, 31}),
          {},
          ""};
}

// Modes that move lenses, pose and, the last one, the scale.
void AddModes(StereoRig& rig) {
  std::mt19937 rng(21);
  std::normal_distribution<double> n(0, 1);
  const int P = rig.left.parameter_count();
  rig.modes.modes = Eigen::MatrixXd::Zero(9, rig.ParameterCount());
  for (int k = 0; k < 8; ++k) {
    auto mode = rig.modes.modes.row(k);
    for (const int first : {0, P}) {
      for (int i = 0; i < 4; ++i) mode[first + i] = 0.2 * n(rng);
      for (int i = 4; i < 6; ++i) mode[first + i] = 1e-3 * n(rng);
      for (int i = 6; i < 8; ++i) mode[first + i] = 1e-5 * n(rng);
    }
    for (int i = 0; i < 3; ++i) mode[2 * P + i] = 4e-5 * n(rng);
    for (int i = 3; i < 6; ++i) mode[2 * P + i] = 0.01 * n(rng);
  }
  rig.modes.modes.row(8).tail<3>() = 2e-4 * rig.right_from_left.translation_mm.transpose();
  rig.modes.has_scale_mode = true;
}

StereoRig Bumped(const StereoRig& rig, const Vector6& bump) {
  StereoRig moved = rig;
  moved.right_from_left =
      Rigid3::FromRotationVector(bump.head<3>(), bump.tail<3>()) * rig.right_from_left;
  return moved;
}

// The part of a motion of the right camera that leaves the baseline as long as it was.
Vector6 WithoutLengthening(const StereoRig& rig, const Vector6& bump) {
  StereoRig moved = Bumped(rig, bump);
  Vector6 out = bump;
  const Rigid3 turned =
      Rigid3::FromRotationVector(bump.head<3>(), Eigen::Vector3d::Zero()) * rig.right_from_left;
  out.tail<3>() =
      moved.right_from_left.translation_mm.normalized() * rig.baseline_mm() - turned.translation_mm;
  return out;
}

enum class Surface { kFlat, kCurved };

// Points all over the view, along a grid in the left image.
std::vector<Eigen::Vector3d> Points(const StereoRig& rig, Surface surface, int columns = 40,
                                    int rows = 34) {
  std::vector<Eigen::Vector3d> points;
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const Eigen::Vector2d q(20 + c * 1240.0 / (columns - 1), 20 + r * 984.0 / (rows - 1));
      const Eigen::Vector3d ray = rig.left.Unproject(q) / rig.left.Unproject(q).z();
      const double x = 500 * ray.x(), y = 500 * ray.y();
      const double z_mm = surface == Surface::kFlat ? 500 + 0.2 * x - 0.1 * y
                                                    : 500 + x * x / 300 - y * y / 500 + 0.1 * x;
      const Eigen::Vector3d point = ray * z_mm;
      const Eigen::Vector2d right = rig.right.Project(rig.right_from_left * point);
      if (rig.right.Contains(right)) points.push_back(point);
    }
  }
  return points;
}

Observations See(const StereoRig& rig, const std::vector<Eigen::Vector3d>& points, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> n(0, kNoise_px);
  Observations out;
  for (const Eigen::Vector3d& p : points) {
    StereoObservation o;
    o.left = rig.left.Project(p) + Eigen::Vector2d(n(rng), n(rng));
    o.right = rig.right.Project(rig.right_from_left * p) + Eigen::Vector2d(n(rng), n(rng));
    o.cov_px2 = Eigen::Matrix4d::Identity() * kNoise_px * kNoise_px;
    out.push_back(o);
  }
  return out;
}

// error' cov^-1 error over the directions that cov has.
double Nees(const Vector6& error, const Matrix6& cov, const Eigen::Vector3d& t, int dimensions) {
  Eigen::MatrixXd E = Matrix6::Identity();
  if (dimensions == 5) {
    E = Eigen::MatrixXd::Zero(6, 5);
    E.topLeftCorner<3, 3>().setIdentity();
    E.col(3).tail<3>() = t.unitOrthogonal();
    E.col(4).tail<3>() = t.normalized().cross(t.unitOrthogonal());
  }
  const Eigen::VectorXd y = E.transpose() * error;
  return y.dot((E.transpose() * cov * E).fullPivLu().solve(y));
}

class BothSurfaces : public ::testing::TestWithParam<Surface> {};

TEST_P(BothSurfaces, FindsABumpWithinItsSigmas) {
  StereoRig rig = MakeRig();
  const auto points = Points(rig, GetParam());
  for (int axis = 0; axis < 6; ++axis) {
    for (const double sign : {-1.0, 1.0}) {
      Vector6 bump = Vector6::Zero();
      bump[axis] = sign * (axis < 3 ? 0.05 * kRad : 0.1);
      const StereoRig moved = Bumped(rig, bump);
      const RelativePose pose =
          RefineRelativePose(rig, See(moved, points, static_cast<unsigned>(axis)));
      const Vector6 expected = WithoutLengthening(rig, bump);
      const double nees =
          Nees(pose.change - expected, pose.cov_random, pose.right_from_left.translation_mm, 5);
      EXPECT_LT(nees, 20.5) << axis;  // 99.9 %
      EXPECT_NEAR(pose.right_from_left.translation_mm.norm(), rig.baseline_mm(), 1e-9);
      EXPECT_NEAR(pose.sigma0, 1, 0.1);
      EXPECT_NEAR(pose.epipolar_rms_after_px, kNoise_px * std::numbers::sqrt2, 2e-3);
    }
  }
}

TEST_P(BothSurfaces, CovarianceIsThatOfSampling) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, GetParam());
  Vector6 bump;
  bump << 8e-4, -5e-4, 6e-4, 0.1, -0.1, 0.05;
  const StereoRig moved = Bumped(rig, bump);
  const Vector6 expected = WithoutLengthening(rig, bump);
  const int draws = 200;
  double nees = 0, chi2 = 0, z2 = 0;
  for (int i = 0; i < draws; ++i) {
    const RelativePose pose =
        RefineRelativePose(rig, See(moved, points, static_cast<unsigned>(100 + i)));
    nees += Nees(pose.change - expected, pose.cov_random, pose.right_from_left.translation_mm, 5) /
            draws;
    z2 += pose.sigma0 * pose.sigma0 / draws;
    chi2 = std::max(chi2, pose.chi2);
    EXPECT_EQ(pose.degrees_of_freedom, 5);
    // Nothing is claimed along the baseline.
    Vector6 along = Vector6::Zero();
    along.tail<3>() = pose.right_from_left.translation_mm.normalized();
    EXPECT_LT(along.dot(pose.cov_random * along), 1e-6 * pose.cov_random.trace());
  }
  EXPECT_NEAR(nees, 5, 0.5);
  EXPECT_NEAR(z2, 1, 0.01);
  EXPECT_GT(chi2, 1000);
}

// A camera that stands still seems to have moved, because the calibration is wrong along its modes
// and the matches are noisy.
TEST_P(BothSurfaces, ChiSquaredIsThatOfACameraThatStandsStill) {
  StereoRig rig = MakeRig();
  AddModes(rig);
  const auto points = Points(rig, GetParam(), 30, 26);
  std::mt19937 rng(31);
  std::normal_distribution<double> n(0, 1);
  const int draws = 400;
  double chi2 = 0, random_alone = 0;
  for (int i = 0; i < draws; ++i) {
    Eigen::VectorXd parameters = rig.Parameters();
    for (int k = 0; k < rig.modes.count(); ++k) {
      parameters += n(rng) * rig.modes.modes.row(k).transpose();
    }
    const RelativePose pose = RefineRelativePose(
        rig, See(rig.WithParameters(parameters), points, static_cast<unsigned>(400 + i)));
    chi2 += pose.chi2 / draws;
    random_alone +=
        Nees(pose.change, pose.cov_random, pose.right_from_left.translation_mm, 5) / draws;
  }
  EXPECT_NEAR(chi2, 5, 0.5);
  EXPECT_GT(random_alone, 20);
}

INSTANTIATE_TEST_SUITE_P(RelativePose, BothSurfaces,
                         ::testing::Values(Surface::kFlat, Surface::kCurved), [](const auto& info) {
                           return info.param == Surface::kFlat ? "Flat" : "Curved";
                         });

// With every point free, and the gauge that AdjustBundle() chooses for the scale.
TEST(RelativePose, IsThatOfBundleAdjustment) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kFlat, 20, 17);
  Vector6 bump;
  bump << 5e-4, 3e-4, -4e-4, 0.05, 0.1, -0.1;
  const StereoRig moved = Bumped(rig, bump);
  const Observations seen = See(moved, points, 9);
  BundleProblem problem;
  problem.cameras = {{rig.left, true}, {rig.right, true}};
  problem.motions = {{rig.right_from_left}};
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const auto point = static_cast<int>(i);
    problem.points.push_back({points[i]});
    problem.observations.push_back(
        {0, -1, -1, point, seen[i].left, seen[i].cov_px2.topLeftCorner<2, 2>()});
    problem.observations.push_back(
        {1, 0, -1, point, seen[i].right, seen[i].cov_px2.bottomRightCorner<2, 2>()});
  }
  BundleOptions options;
  options.gauge = BundleGauge::kMinimalPrior;
  const BundleResult bundle = AdjustBundle(problem, options);
  ASSERT_TRUE(bundle.converged);
  ASSERT_EQ(bundle.gauge_directions, 1);
  const Rigid3& adjusted = bundle.solved.motions[0].motion;
  // What AdjustBundle() calls its motion's parameters, as a change with the baseline held.
  const auto change = [&](const Eigen::VectorXd& parameters) -> Eigen::VectorXd {
    Rigid3 at = Rigid3::FromRotationVector(parameters.head<3>(), parameters.tail<3>());
    at.translation_mm *= rig.baseline_mm() / at.translation_mm.norm();
    const Rigid3 motion = at * rig.right_from_left.Inverse();
    Vector6 out;
    out << motion.RotationVector(), motion.translation_mm;
    return out;
  };
  Vector6 parameters;
  parameters << adjusted.RotationVector(), adjusted.translation_mm;
  const Eigen::MatrixXd J = testing::NumericJacobian(change, parameters, 1e-5);
  const std::vector<BundleBlock> block = {BundleBlock::Motion(0)};
  const Matrix6 cov = J * bundle.Covariance(block) * J.transpose();

  const RelativePose pose = RefineRelativePose(rig, seen);
  EXPECT_EQ(pose.mismatches, 0);
  const Eigen::Vector3d& t = pose.right_from_left.translation_mm;
  EXPECT_LT(Nees(pose.change - change(parameters), cov, t, 5), 1e-4);
  EXPECT_NEAR(pose.sigma0, bundle.sigma0, 1e-3);
  const Vector6 sigma = cov.diagonal().cwiseSqrt().cwiseInverse();
  EXPECT_LT(
      (sigma.asDiagonal() * (pose.cov_random - cov) * sigma.asDiagonal()).cwiseAbs().maxCoeff(),
      1e-3);
}

// What the refined pose is for: lengths that a bump falsified are right again.
TEST(RelativePose, BringsTheShapeBack) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kCurved);
  Vector6 bump = WithoutLengthening(rig, (Vector6() << 4e-4, 8e-4, -6e-4, 0.1, 0.1, 0).finished());
  const StereoRig moved = Bumped(rig, bump);
  const std::size_t ends[] = {0, 25, points.size() / 2, points.size() - 1};
  const auto lengths = [&](const StereoRig& with) {
    Eigen::VectorXd out(3);
    std::vector<Eigen::Vector3d> seen;
    for (const std::size_t i : ends) {
      seen.push_back(Triangulate(with, {moved.left.Project(points[i]),
                                        moved.right.Project(moved.right_from_left * points[i])})
                         .point_in_rig);
    }
    for (Eigen::Index k = 0; k < 3; ++k) {
      out[k] = (seen[static_cast<std::size_t>(k + 1)] - seen[0]).norm();
    }
    return out;
  };
  const Eigen::VectorXd truth = lengths(moved);
  const Eigen::MatrixXd J = testing::NumericJacobian(
      [&](const Eigen::VectorXd& d) -> Eigen::VectorXd { return lengths(Bumped(rig, d)); }, bump,
      1e-5);
  double square = 0;
  const int draws = 100;
  for (int i = 0; i < draws; ++i) {
    const RelativePose pose =
        RefineRelativePose(rig, See(moved, points, static_cast<unsigned>(900 + i)));
    StereoRig refined = rig;
    refined.right_from_left = pose.right_from_left;
    const Eigen::Matrix3d cov = J * pose.cov_random * J.transpose();
    const Eigen::Vector3d error = lengths(refined) - truth;
    const Eigen::Vector3d before = lengths(rig) - truth;
    for (int k = 0; k < 3; ++k) {
      const double sigma_mm = std::sqrt(cov(k, k));
      EXPECT_GT(std::abs(before[k]), 10 * sigma_mm);
      square += error[k] * error[k] / cov(k, k) / (3 * draws);
    }
  }
  EXPECT_NEAR(square, 1, 0.3);  // the three go together
}

TEST(RelativePose, AKnownDistanceSetsTheScale) {
  StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kCurved);
  Vector6 bump;
  bump << 3e-4, -2e-4, 5e-4, 0.3, -0.05, 0.1;
  const StereoRig moved = Bumped(rig, bump);
  RelativePoseOptions options;
  DistanceBetweenObservations known{3, points.size() - 4, 0,
                                    5e-4};  // small: what the pose does to it shows
  std::mt19937 rng(41);
  std::normal_distribution<double> n(0, 1);
  double nees = 0, lengthening = 0;
  const int draws = 200;
  for (int i = 0; i < draws; ++i) {
    known.distance_mm = (points[known.a] - points[known.b]).norm() + known.sigma_mm * n(rng);
    options.known_distance = known;
    const Observations seen = See(moved, points, static_cast<unsigned>(1300 + i));
    const RelativePose pose = RefineRelativePose(rig, seen, options);
    EXPECT_EQ(pose.degrees_of_freedom, 6);
    nees +=
        Nees(pose.change - bump, pose.cov_random, pose.right_from_left.translation_mm, 6) / draws;
    lengthening += (pose.right_from_left.translation_mm.norm() - moved.baseline_mm()) / draws;
    StereoRig refined = rig;
    refined.right_from_left = pose.right_from_left;
    EXPECT_NEAR((Triangulate(refined, seen[known.a]).point_in_rig -
                 Triangulate(refined, seen[known.b]).point_in_rig)
                    .norm(),
                known.distance_mm, 1e-6);
  }
  EXPECT_NEAR(nees, 6, 0.6);
  EXPECT_NEAR(lengthening, 0, 0.005);
}

// With a known distance the scale of the calibration takes part, in place of that of the baseline.
TEST(RelativePose, ChiSquaredWithAKnownDistanceHasSixDegrees) {
  StereoRig rig = MakeRig();
  AddModes(rig);
  const auto points = Points(rig, Surface::kCurved, 30, 26);
  DistanceBetweenObservations known{3, points.size() - 4, 0, 0.02};
  known.distance_mm = (points[known.a] - points[known.b]).norm();
  std::mt19937 rng(43);
  std::normal_distribution<double> n(0, 1);
  const int draws = 400;
  double chi2 = 0;
  for (int i = 0; i < draws; ++i) {
    Eigen::VectorXd parameters = rig.Parameters();
    for (int k = 0; k < rig.modes.count(); ++k) {
      parameters += n(rng) * rig.modes.modes.row(k).transpose();
    }
    RelativePoseOptions options;
    options.known_distance = known;
    options.known_distance->distance_mm += known.sigma_mm * n(rng);
    chi2 += RefineRelativePose(
                rig, See(rig.WithParameters(parameters), points, static_cast<unsigned>(3000 + i)),
                options)
                .chi2 /
            draws;
  }
  EXPECT_NEAR(chi2, 6, 0.6);
}

TEST(RelativePose, GrossMismatchesDoNotMatter) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kCurved);
  Vector6 bump = Vector6::Zero();
  bump[0] = 0.05 * kRad;
  const StereoRig moved = Bumped(rig, bump);
  const Vector6 expected = WithoutLengthening(rig, bump);
  std::mt19937 rng(51);
  std::uniform_real_distribution<double> far(0.2, 60);
  double nees = 0;
  const int draws = 100;
  for (int i = 0; i < draws; ++i) {
    Observations seen = See(moved, points, static_cast<unsigned>(1700 + i));
    for (std::size_t k = static_cast<std::size_t>(i % 20); k < seen.size(); k += 20) {
      seen[k].right += Eigen::Vector2d(far(rng), far(rng));  // all to one side
    }
    const RelativePose pose = RefineRelativePose(rig, seen);
    nees += Nees(pose.change - expected, pose.cov_random, pose.right_from_left.translation_mm, 5) /
            draws;
    EXPECT_GE(pose.mismatches, static_cast<int>(seen.size()) / 20 - 2);
    EXPECT_LT(pose.mismatches, static_cast<int>(seen.size()) / 20 + 5);
    EXPECT_LT(pose.epipolar_rms_after_px, 0.02);
  }
  EXPECT_NEAR(nees, 5, 1);
}

TEST(RelativePose, CountsTheScatterOfTheMatchesWhereItIsAskedTo) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kCurved, 20, 17);
  RelativePoseOptions options;
  options.scale_by_scatter = true;
  double chi2 = 0, nees = 0;
  const int draws = 200;
  for (int i = 0; i < draws; ++i) {
    Observations seen = See(rig, points, static_cast<unsigned>(4000 + i));
    for (StereoObservation& match : seen) match.cov_px2 /= 9;
    const RelativePose pose = RefineRelativePose(rig, seen, options);
    EXPECT_NEAR(pose.sigma0, 3, 0.5);
    chi2 += pose.chi2 / draws;
    nees += Nees(pose.change, pose.cov_random, pose.right_from_left.translation_mm, 5) / draws;
  }
  EXPECT_NEAR(chi2, 5, 1);
  EXPECT_NEAR(nees, 5, 1);
  // Matches that scatter less than they claim are not believed to be better.
  Observations seen = See(rig, points, 4500);
  for (StereoObservation& match : seen) match.cov_px2 *= 9;
  EXPECT_EQ(RefineRelativePose(rig, seen, options).cov_random,
            RefineRelativePose(rig, seen).cov_random);
}

TEST(RelativePose, CountsThatMatchesShareNoise) {
  const StereoRig rig = MakeRig();
  const auto points = Points(rig, Surface::kCurved, 20, 17);
  RelativePoseOptions options;
  options.alike_points = 4;
  double chi2 = 0;
  const int draws = 200;
  for (int i = 0; i < draws; ++i) {
    const Observations once = See(rig, points, static_cast<unsigned>(5000 + i));
    Observations seen;
    for (const StereoObservation& match : once) seen.insert(seen.end(), 4, match);
    const RelativePose pose = RefineRelativePose(rig, seen, options);
    chi2 += pose.chi2 / draws;
    if (i > 0) continue;
    const RelativePose of_once = RefineRelativePose(rig, once);
    EXPECT_TRUE(pose.cov_random.isApprox(of_once.cov_random, 1e-6));
    // Thinned to a quarter, no two are alike.
    options.max_points = static_cast<int>(once.size());
    EXPECT_TRUE(RefineRelativePose(rig, seen, options).cov_random.isApprox(pose.cov_random, 1e-6));
    options.max_points = 6000;
  }
  EXPECT_NEAR(chi2, 5, 0.8);
  options.alike_points = static_cast<double>(points.size()) / 3;
  EXPECT_THROW((void)RefineRelativePose(rig, See(rig, points, 5500), options), InputError);
}

TEST(RelativePose, TellsTheDistancesFromTheEpipolarLinesOfThreePoses) {
  const StereoRig rig = MakeRig();
  Vector6 bump = Vector6::Zero();
  bump[0] = 0.01 * kRad;
  const StereoRig moved = Bumped(rig, bump);
  const Observations seen = See(moved, Points(rig, Surface::kCurved), 60);
  RelativePoseOptions options;
  options.other_pose = moved.right_from_left;
  options.outlier_sigmas = 1e3;  // all are used
  const RelativePose pose = RefineRelativePose(rig, seen, options);
  double mean = 0, before = 0, other = 0, expected = 0;
  for (const StereoObservation& match : seen) {
    const TriangulatedPoint a = Triangulate(rig, match), b = Triangulate(moved, match);
    const double n = static_cast<double>(seen.size());
    mean += a.epipolar_px / n;
    before += a.epipolar_px * a.epipolar_px / n;
    other += b.epipolar_px * b.epipolar_px / n;
    expected += b.sigma_epipolar_px * b.sigma_epipolar_px / n;
  }
  EXPECT_NEAR(pose.epipolar_mean_before_px, mean, 1e-9);
  EXPECT_NEAR(pose.epipolar_rms_before_px, std::sqrt(before), 1e-9);
  EXPECT_NEAR(pose.epipolar_rms_other_px, std::sqrt(other), 1e-9);
  EXPECT_NEAR(pose.epipolar_sigma_px, std::sqrt(expected), 1e-5);
  EXPECT_TRUE(std::isnan(RefineRelativePose(rig, seen).epipolar_rms_other_px));
}

TEST(RelativePose, ADifferenceBetweenInstantsIsFreeOfTheCalibration) {
  StereoRig rig = MakeRig();
  AddModes(rig);
  const auto points = Points(rig, Surface::kCurved, 30, 26);
  Eigen::VectorXd parameters = rig.Parameters();
  for (int k = 0; k < rig.modes.count(); ++k) {
    parameters += (k % 2 == 0 ? 1 : -1) * rig.modes.modes.row(k).transpose();
  }
  const StereoRig truth = rig.WithParameters(parameters);
  Vector6 bump = Vector6::Zero();
  bump[1] = 0.005 * kRad;
  const StereoRig bumped = Bumped(truth, bump);
  const int draws = 200;
  double still = 0, nees = 0;
  for (int i = 0; i < draws; ++i) {
    const auto at = [&](const StereoRig& seen_by, int seed) {
      return RefineRelativePose(rig, See(seen_by, points, static_cast<unsigned>(seed)));
    };
    const RelativePose earlier = at(truth, 2000 + i);
    const PoseChange none = Between(earlier, at(truth, 2300 + i));
    still += none.chi2 / draws;
    EXPECT_EQ(none.degrees_of_freedom, 5);
    const RelativePose later = at(bumped, 2600 + i);
    const PoseChange moved = Between(earlier, later);
    EXPECT_GT(moved.chi2, 25);
    const Rigid3 there =
        Rigid3::FromRotationVector(moved.change.head<3>(), moved.change.tail<3>()) *
        earlier.right_from_left;
    EXPECT_LT((there.Matrix() - later.right_from_left.Matrix()).norm(), 1e-9);
    nees += Nees(moved.change - WithoutLengthening(truth, bump), moved.cov_random,
                 later.right_from_left.translation_mm, 5) /
            draws;
  }
  EXPECT_NEAR(still, 5, 0.5);
  EXPECT_NEAR(nees, 5, 0.5);
}

TEST(RelativePose, RefusesPointsThatDoNotDetermineIt) {
  const StereoRig rig = MakeRig();
  const auto all = Points(rig, Surface::kCurved);
  const auto refuses = [&](const std::vector<Eigen::Vector3d>& points) {
    try {
      (void)RefineRelativePose(rig, See(rig, points, 5));
    } catch (const InputError&) {
      return true;
    }
    return false;
  };
  EXPECT_FALSE(refuses(all));
  EXPECT_TRUE(refuses({}));
  EXPECT_TRUE(refuses({all.begin(), all.begin() + 11}));
  std::vector<Eigen::Vector3d> line, row, corner;
  for (int i = 0; i < 400; ++i) line.emplace_back(-80 + 0.4 * i, -60 + 0.3 * i, 480 + 0.1 * i);
  for (int i = 0; i < 400; ++i) {
    row.push_back(rig.left.Unproject({100 + 2.5 * i, 512}) * (500 + 20 * std::sin(0.03 * i)));
  }
  for (int i = 0; i < 400; ++i) corner.emplace_back(-60 + 0.5 * (i % 20), -60 + 0.025 * i, 500);
  EXPECT_TRUE(refuses(line));
  EXPECT_TRUE(refuses(row));
  EXPECT_TRUE(refuses(corner));
}

TEST(RelativePose, LeavesOutWhatHasNoRayAndThinsTheRest) {
  const StereoRig rig = MakeRig();
  Observations seen = See(rig, Points(rig, Surface::kCurved), 6);
  seen[7].right.x() = std::nan("");
  seen[9].left.y() = std::nan("");
  const RelativePose all = RefineRelativePose(rig, seen);
  EXPECT_EQ(all.points + all.mismatches, static_cast<int>(seen.size()) - 2);
  RelativePoseOptions options;
  options.max_points = 300;
  const RelativePose some = RefineRelativePose(rig, seen, options);
  EXPECT_NEAR(some.points, 300, 3);
  const double ratio =
      some.cov_random.topLeftCorner<3, 3>().trace() / all.cov_random.topLeftCorner<3, 3>().trace();
  EXPECT_NEAR(ratio, static_cast<double>(seen.size()) / 300, 0.5);
}

TEST(RelativePose, GivesTheSameBitsForAnyNumberOfThreads) {
  StereoRig rig = MakeRig();
  AddModes(rig);
  const Observations seen = See(rig, Points(rig, Surface::kFlat), 7);
  const RelativePose many = RefineRelativePose(rig, seen);
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
  const RelativePose one = RefineRelativePose(rig, seen);
  EXPECT_EQ(one.change, many.change);
  EXPECT_EQ(one.cov_calibration, many.cov_calibration);
}

TEST(RelativePose, RefusesNonsense) {
  const StereoRig rig = MakeRig();
  Observations seen = See(rig, Points(rig, Surface::kCurved), 8);
  RelativePoseOptions options;
  options.known_distance = DistanceBetweenObservations{0, seen.size(), 100};
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), std::invalid_argument);
  options.known_distance->b = 0;
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), std::invalid_argument);
  options.known_distance = DistanceBetweenObservations{0, 1, -100};
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), UsageError);
  options = {};
  options.max_points = 5;
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), UsageError);
  options = {};
  options.alike_points = 0.5;
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), UsageError);
  options = {};
  options.outlier_sigmas = 0;
  EXPECT_THROW((void)RefineRelativePose(rig, seen, options), UsageError);
  seen[4].cov_px2.setZero();
  EXPECT_THROW((void)RefineRelativePose(rig, seen), std::invalid_argument);
}

}  // namespace
}  // namespace plumbline
