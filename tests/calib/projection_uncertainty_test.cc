#include "calib/projection_uncertainty.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "calib/camera_file.h"
#include "calib/error.h"
#include "calib/internal/mrcal_solver.h"
#include "calib/stereo_rig.h"
#include "calib/triangulate.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/shared_data.h"
#include "tests/support/synthetic_calibration.h"

namespace plumbline {
namespace {

using Eigen::Vector2d, Eigen::Vector3d;
using testing::MakeSyntheticCalibration;
using testing::SyntheticCalibrationOptions;

constexpr double kNoise_px = 0.1;
constexpr double kDistance_mm = 350;

Rigid3 PoseOf(const OptimizationInputs::RowMatrix6& rt, Eigen::Index row) {
  return Rigid3::FromRotationVector(rt.row(row).head<3>().transpose(),
                                    rt.row(row).tail<3>().transpose() * 1000);
}

StereoRig RigOf(const OptimizationInputs& in) {
  return {in.CameraAt(0), in.CameraAt(1), PoseOf(in.extrinsics_rt_fromref, 0), {}, ""};
}

std::vector<Vector2d> CoveredPixels() {
  std::vector<Vector2d> pixels;
  for (const double y : {120., 240., 360.}) {
    for (const double x : {140., 320., 500.}) pixels.emplace_back(x, y);
  }
  return pixels;
}

// Where camera `c` of a new solve sees the point that the old one saw at `p`: the camera's motion
// is found without any linearisation, by fitting the new geometry, through the old lens, to the old
// pixels.
Rigid3 OldFromNewCamera(const OptimizationInputs& old_solve, const OptimizationInputs& new_solve,
                        int c) {
  const Camera lens = old_solve.CameraAt(c);
  const auto& indices = old_solve.indices_frame_camintrinsics_camextrinsics;
  Rigid3 motion;
  for (int iteration = 0; iteration < 4; ++iteration) {
    Eigen::Matrix<double, 6, 6> N = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
    for (int o = 0; o < old_solve.board_observation_count(); ++o) {
      if (indices(o, 1) != c) continue;
      const Rigid3 camera_from_ref =
          indices(o, 2) < 0 ? Rigid3() : PoseOf(new_solve.extrinsics_rt_fromref, indices(o, 2));
      const Rigid3 pose = camera_from_ref * PoseOf(new_solve.frames_rt_toref, indices(o, 0));
      for (int k = 0; k < old_solve.board_rows * old_solve.board_columns; ++k) {
        const auto seen = old_solve.observations_board.row(
            o * old_solve.board_rows * old_solve.board_columns + k);
        if (seen[2] < 0) continue;
        const double spacing = 1000 * old_solve.calibration_object_spacing;
        const Vector3d corner(spacing * (k % old_solve.board_columns),
                              spacing * (k / old_solve.board_columns), 0);
        const Vector3d p = motion * (pose * corner);
        const auto at = lens.ProjectWithJacobians(p);
        Eigen::Matrix<double, 3, 6> dp;
        dp << -Skew(p), Eigen::Matrix3d::Identity();
        const Eigen::Matrix<double, 2, 6> J = at.d_pixel_d_point * dp;
        N += J.transpose() * J;
        g += J.transpose() * (seen.head<2>().transpose() - at.pixel);
      }
    }
    const Eigen::Matrix<double, 6, 1> step = N.ldlt().solve(g);
    motion = Rigid3::FromRotationVector(step.head<3>(), step.tail<3>()) * motion;
  }
  return motion;
}

const std::pair<Vector3d, Vector3d> kLengths[] = {
    {{-40, -30, 350}, {60, -30, 350}},  // across
    {{10, -50, 340}, {10, 50, 360}},    // down
    {{20, 0, 320}, {20, 0, 380}},       // in depth
};

// What many re-solves from fresh noise scatter by.
struct Scatter {
  std::vector<Eigen::Matrix2d> pixel[2];  // covariance a camera, a covered pixel
  std::vector<Eigen::Matrix3d> point;  // covariance (mm^2) of the stabilised point, a covered pixel
  double length_variance[3] = {0, 0, 0};  // mm^2
};

Scatter MonteCarlo(const OptimizationInputs& truth, int draws) {
  const std::vector<Vector2d> pixels = CoveredPixels();
  const StereoRig rig = RigOf(truth);
  Scatter s;
  for (auto& covariances : s.pixel) covariances.assign(pixels.size(), Eigen::Matrix2d::Zero());
  s.point.assign(pixels.size(), Eigen::Matrix3d::Zero());
  for (int d = 0; d < draws; ++d) {
    OptimizationInputs solve = truth;
    testing::SetObservations(truth, kNoise_px, static_cast<std::uint64_t>(1000 + d), solve);
    EXPECT_TRUE(internal::SolveWithMrcal(solve).usable());
    const StereoRig new_rig = RigOf(solve);
    for (int c = 0; c < 2; ++c) {
      const Rigid3 old_from_new = OldFromNewCamera(truth, solve, c);
      const Camera old_lens = truth.CameraAt(c), new_lens = solve.CameraAt(c);
      for (std::size_t i = 0; i < pixels.size(); ++i) {
        const Vector3d p = old_lens.Unproject(pixels[i]) * kDistance_mm;
        const Vector2d dq = new_lens.Project(old_from_new.Inverse() * p) - pixels[i];
        s.pixel[c][i] += dq * dq.transpose() / draws;
        if (c == 1) continue;
        const auto again = Triangulate(
            new_rig,
            {pixels[i], rig.right.Project(rig.right_from_left * p), Eigen::Matrix4d::Identity()});
        const Vector3d dp = old_from_new * again.point_in_rig - p;
        s.point[i] += dp * dp.transpose() / draws;
      }
    }
    for (int k = 0; k < 3; ++k) {
      const auto again = [&](const Vector3d& p) {
        return Triangulate(new_rig,
                           {rig.left.Project(p), rig.right.Project(rig.right_from_left * p),
                            Eigen::Matrix4d::Identity()})
            .point_in_rig;
      };
      const auto& [a, b] = kLengths[k];
      const double dl = (again(a) - again(b)).norm() - (a - b).norm();
      s.length_variance[k] += dl * dl / draws;
    }
  }
  return s;
}

double SigmaRatio(const Eigen::MatrixXd& claimed, const Eigen::MatrixXd& found) {
  return std::sqrt(claimed.trace() / found.trace());
}

ProjectionUncertainty UncertaintyOf(const OptimizationInputs& inputs) {
  ProjectionUncertainty::Options options;
  options.noise_px = kNoise_px;
  return ProjectionUncertainty(inputs, options);
}

OptimizationInputs Truth(LensModel::Kind kind) {
  SyntheticCalibrationOptions options;
  options.model = kind;
  return MakeSyntheticCalibration(options);
}

// Compares and prints one line a quantity; `tolerance` is relative, of a sigma.
void CompareWithMonteCarlo(LensModel::Kind kind, int draws, double tolerance) {
  const OptimizationInputs truth = Truth(kind);
  const ProjectionUncertainty claimed = UncertaintyOf(truth);
  const Scatter found = MonteCarlo(truth, draws);
  const std::vector<Vector2d> pixels = CoveredPixels();
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    for (int c = 0; c < 2; ++c) {
      const Vector3d p = truth.CameraAt(c).Unproject(pixels[i]) * kDistance_mm;
      const Eigen::Matrix2d cross = claimed.CrossReprojection(c, p);
      const double ratio = SigmaRatio(cross, found.pixel[c][i]);
      std::printf(
          "%s camera %d pixel (%3.0f, %3.0f): found %.4f px, cross-reprojection %.4f (x %.3f), "
          "mean-pcam %.4f (x %.3f)\n",
          truth.lens_model.Name().c_str(), c, pixels[i].x(), pixels[i].y(),
          std::sqrt(found.pixel[c][i].trace() / 2), std::sqrt(cross.trace() / 2), ratio,
          std::sqrt(claimed.MeanPcam(c, p).trace() / 2),
          SigmaRatio(claimed.MeanPcam(c, p), found.pixel[c][i]));
      EXPECT_NEAR(ratio, 1, tolerance) << "camera " << c << " pixel " << pixels[i].transpose();
    }
    const Vector3d p = truth.CameraAt(0).Unproject(pixels[i]) * kDistance_mm;
    const Eigen::Matrix3d point = claimed.TriangulatedPoint(0, 1, p);
    std::printf("   point there: found %.5f mm, claimed %.5f (x %.3f)\n",
                std::sqrt(found.point[i].trace()), std::sqrt(point.trace()),
                SigmaRatio(point, found.point[i]));
    // Dominated by its depth: one degree of freedom, so it scatters more.
    EXPECT_NEAR(SigmaRatio(point, found.point[i]), 1, 1.4 * tolerance) << pixels[i].transpose();
  }
  for (int k = 0; k < 3; ++k) {
    const double sigma =
        std::sqrt(claimed.LengthVariance(0, 1, kLengths[k].first, kLengths[k].second));
    const double ratio = sigma / std::sqrt(found.length_variance[k]);
    std::printf("%s length %d: found %.5f mm, claimed %.5f (x %.3f)\n",
                truth.lens_model.Name().c_str(), k, std::sqrt(found.length_variance[k]), sigma,
                ratio);
    EXPECT_NEAR(ratio, 1, tolerance) << "length " << k;
  }
}

TEST(ProjectionUncertainty, AgreesWithAFewMonteCarloResolves) {
  CompareWithMonteCarlo(LensModel::Kind::kOpenCv4, 60, 0.28);
}

TEST(ProveProjectionUncertainty, AgreesWith200MonteCarloResolves) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr) GTEST_SKIP() << "set PLUMBLINE_PROVE to run";
  CompareWithMonteCarlo(LensModel::Kind::kOpenCv5, 200, 0.10);
  CompareWithMonteCarlo(LensModel::Kind::kOpenCv4, 200, 0.10);
}

// Everything mrcal's own Python says about one input, ours beside it.
class MeanPcamOf : public ::testing::TestWithParam<std::tuple<LensModel::Kind, bool>> {};

TEST_P(MeanPcamOf, EqualsPythonMrcal) {
  SyntheticCalibrationOptions options;
  options.model = std::get<0>(GetParam());
  options.noise_px = kNoise_px;
  OptimizationInputs inputs = MakeSyntheticCalibration(options);
  inputs.do_apply_regularization = std::get<1>(GetParam());
  if (inputs.do_apply_regularization) {
    inputs.calobject_warp = Vector2d(0, 0);
    inputs.do_optimize_calobject_warp = true;
    inputs.do_apply_outlier_rejection = true;
    inputs.observations_board(30, 0) += 3;
  }
  ASSERT_TRUE(internal::SolveWithMrcal(inputs).usable());
  const auto folder = testing::TestFolder();
  for (int c = 0; c < 2; ++c) {
    WriteCameraModel(folder / (std::to_string(c) + ".cameramodel"), inputs.CameraAt(c),
                     c == 0 ? Rigid3() : PoseOf(inputs.extrinsics_rt_fromref, 0), &inputs, c);
  }
  const auto result = testing::RunPython(R"(
import sys, numpy as np, mrcal
for c in range(2):
    m = mrcal.cameramodel(sys.argv[1] + '/%d.cameramodel' % c)
    for q in ((100., 80.), (320., 240.), (600., 400.)):
        for distance, infinite in ((0.35, False), (5., False), (1., True)):
            v = mrcal.unproject(np.array(q), *m.intrinsics(), normalize=True) * distance
            V = mrcal.projection_uncertainty(v, m, what='covariance', atinfinity=infinite,
                                             observed_pixel_uncertainty=0.1)
            print(c, *[repr(float(k)) for k in (*(v * 1000), infinite, *V.ravel())])
)",
                                         folder.string());
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const ProjectionUncertainty ours = UncertaintyOf(inputs);
  std::istringstream lines(result.output);
  int camera = 0, count = 0;
  Vector3d p;
  double infinite = 0;
  Eigen::Matrix2d theirs;
  double worst = 0;
  while (lines >> camera >> p[0] >> p[1] >> p[2] >> infinite >> theirs(0, 0) >> theirs(0, 1) >>
         theirs(1, 0) >> theirs(1, 1)) {
    const double difference =
        (ours.MeanPcam(camera, p, infinite != 0) - theirs).norm() / theirs.norm();
    worst = std::max(worst, difference);
    ++count;
  }
  EXPECT_EQ(count, 18);
  EXPECT_LT(worst, 1e-6);
  std::printf("largest relative difference from python3-mrcal: %.2e\n", worst);
}

// A splined model without regularization leaves the knots that no corner touched undetermined.
INSTANTIATE_TEST_SUITE_P(ProjectionUncertainty, MeanPcamOf,
                         ::testing::Values(std::make_tuple(LensModel::Kind::kOpenCv5, false),
                                           std::make_tuple(LensModel::Kind::kOpenCv5, true),
                                           std::make_tuple(LensModel::Kind::kOpenCv8, true),
                                           std::make_tuple(LensModel::Kind::kSplinedStereographic,
                                                           true)));

TEST(ProjectionUncertainty, NoiseIsEstimatedFromTheResidualsAndTheirFreedom) {
  SyntheticCalibrationOptions options;
  options.noise_px = 0.2;
  options.pair_count = 6;  // few, so that the unknowns count
  OptimizationInputs inputs = MakeSyntheticCalibration(options);
  ASSERT_TRUE(internal::SolveWithMrcal(inputs).usable());
  EXPECT_NEAR(ProjectionUncertainty(inputs).noise_px(), 0.2, 0.2 * 4 / std::sqrt(2 * 2 * 12 * 63));
}

TEST(ProjectionUncertainty, DoesNotDependOnWhichCameraIsTheReference) {
  const OptimizationInputs first = Truth(LensModel::Kind::kOpenCv5);
  // The same calibration with camera 1 at the reference.
  OptimizationInputs second = first;
  const Rigid3 right_from_left = PoseOf(first.extrinsics_rt_fromref, 0);
  const auto set = [](OptimizationInputs::RowMatrix6& rt, Eigen::Index row, const Rigid3& pose) {
    rt.row(row) << pose.RotationVector().transpose(), pose.translation_mm.transpose() / 1000;
  };
  set(second.extrinsics_rt_fromref, 0, right_from_left.Inverse());
  for (Eigen::Index f = 0; f < first.frames_rt_toref.rows(); ++f) {
    set(second.frames_rt_toref, f, right_from_left * PoseOf(first.frames_rt_toref, f));
  }
  for (Eigen::Index o = 0; o < first.board_observation_count(); ++o) {
    auto row = second.indices_frame_camintrinsics_camextrinsics.row(o);
    row[2] = row[1] == 0 ? 0 : -1;
  }
  const ProjectionUncertainty a = UncertaintyOf(first), b = UncertaintyOf(second);
  const Vector3d p(40, -30, 360), q(-20, 35, 340);
  for (int c = 0; c < 2; ++c) {
    for (const bool infinite : {false, true}) {
      const Eigen::Matrix2d x = a.CrossReprojection(c, p, infinite);
      EXPECT_LT((x - b.CrossReprojection(c, p, infinite)).norm(), 1e-6 * x.norm());
    }
  }
  EXPECT_NEAR(b.LengthVariance(0, 1, p, q) / a.LengthVariance(0, 1, p, q), 1, 1e-6);
  const Eigen::Matrix3d x = a.TriangulatedPoint(0, 1, p);
  EXPECT_LT((x - b.TriangulatedPoint(0, 1, p)).norm(), 1e-6 * x.norm());
}

TEST(ProjectionUncertainty, GrowsOutsideTheCoveredImageAndWithTheNoise) {
  const OptimizationInputs truth = Truth(LensModel::Kind::kOpenCv5);
  const ProjectionUncertainty u = UncertaintyOf(truth);
  const Camera camera = truth.CameraAt(0);
  const double centre = u.CrossReprojection(0, camera.Unproject({320, 240}) * kDistance_mm).trace();
  const double corner = u.CrossReprojection(0, camera.Unproject({2, 2}) * kDistance_mm).trace();
  EXPECT_GT(corner, 4 * centre);
  ProjectionUncertainty::Options twice;
  twice.noise_px = 2 * kNoise_px;
  EXPECT_NEAR(ProjectionUncertainty(truth, twice)
                      .CrossReprojection(0, camera.Unproject({320, 240}) * kDistance_mm)
                      .trace() /
                  centre,
              4, 1e-9);
}

TEST(ProjectionUncertainty, RefusesWhatItCannotAnswer) {
  const OptimizationInputs truth = Truth(LensModel::Kind::kOpenCv5);
  const ProjectionUncertainty u = UncertaintyOf(truth);
  EXPECT_THROW(u.MeanPcam(2, {0, 0, 300}), InputError);
  EXPECT_THROW(u.MeanPcam(0, {0, 0, -300}), InputError);
  EXPECT_THROW(u.LengthVariance(0, 1, {0, 0, 300}, {0, 0, 300}), InputError);
  OptimizationInputs fixed = truth;
  fixed.do_optimize_frames = fixed.do_optimize_extrinsics = false;
  const ProjectionUncertainty only_lens = UncertaintyOf(fixed);
  EXPECT_NO_THROW(only_lens.MeanPcam(0, {0, 0, 300}));
  EXPECT_THROW(only_lens.CrossReprojection(0, {0, 0, 300}), InputError);
  SyntheticCalibrationOptions one;
  one.pair_count = 1;
  one.model = LensModel::Kind::kSplinedStereographic;
  EXPECT_THROW(UncertaintyOf(MakeSyntheticCalibration(one)), InputError);  // knots nobody saw
}

}  // namespace
}  // namespace plumbline
