#include "calib/calibrate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <random>

#include "calib/calibration_report.h"
#include "calib/error.h"
#include "calib/internal/board_adjustment.h"
#include "calib/internal/mrcal_solver.h"
#include "calib/triangulate.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/synthetic_boards.h"

namespace plumbline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using testing::MakeSyntheticBoards;
using testing::SyntheticBoards;
using testing::SyntheticBoardsOptions;

constexpr ImageSize kSize{1280, 960};

CalibrationOptions Quick() {
  CalibrationOptions o;
  o.model = LensModel::FromName("OPENCV5");
  o.compare_halves = false;
  return o;
}

Calibration CalibrateBoards(const SyntheticBoards& boards,
                            const CalibrationOptions& options = Quick(),
                            const SyntheticBoardsOptions& made = {}) {
  return Calibrate(made.board, kSize, kSize, boards.pairs, options);
}

// A length of 60 mm across the middle of the field, as the rig measures pixels that truly lie 60 mm
// apart.
double MeasuredLength(const StereoRig& truth, const StereoRig& rig) {
  std::vector<Eigen::Vector2d> left, right;
  for (double x : {-10.0, 50.0}) {
    const Eigen::Vector3d p(x, 10, 400);
    left.push_back(truth.left.Project(p));
    right.push_back(truth.right.Project(truth.right_from_left * p));
  }
  const auto points = TriangulatePoints(rig, left, right);
  return (points[0] - points[1]).norm();
}

TEST(Calibrate, FindsTheRigWithinItsErrorBars) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  const Calibration c = CalibrateBoards(boards);
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.001);
  EXPECT_EQ(c.outlier_count, 0);
  const Eigen::VectorXd error = c.rig.Parameters() - boards.truth.Parameters();
  for (Eigen::Index i = 0; i < error.size(); ++i)
    EXPECT_LT(std::abs(error[i]), 4.5 * std::sqrt(c.covariance(i, i))) << i;
  EXPECT_LT(c.sigma_baseline_mm, 0.05);
}

TEST(Calibrate, MeasuresAMisprintedBoardInsteadOfTrustingIt) {
  SyntheticBoardsOptions made;
  made.board_noise_mm = 0.03;
  const SyntheticBoards boards = MakeSyntheticBoards(made);
  const Calibration c = CalibrateBoards(boards);
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.001);
  EXPECT_GT(c.rigid_rms_px, 4 * c.joint_rms_px);
  EXPECT_GT(c.fixed_to_board_share, 0.9);
  EXPECT_NEAR(c.target_rms_in_plane_mm, 0.03, 0.004);
  CalibrationOptions rigid = Quick();
  rigid.rigid_target = true;
  const Calibration r = CalibrateBoards(boards, rigid);
  EXPECT_EQ(r.joint_rms_px, r.rigid_rms_px);
  EXPECT_THAT(r.warnings, Contains(HasSubstr("fixed to the board")));
}

// Normalised squared error of baseline and of a length over noise draws, by either covariance.
struct Consistency {
  double clustered_baseline = 0, independent_baseline = 0, clustered_length = 0;
};

Consistency Sample(SyntheticBoardsOptions made, int draws) {
  Consistency mean;
  for (int draw = 0; draw < draws; ++draw) {
    made.seed = 100 + static_cast<std::uint64_t>(draw);
    const SyntheticBoards boards = MakeSyntheticBoards(made);
    CalibrationOptions options = Quick();
    options.scale_sigma = 0;
    const Calibration c = CalibrateBoards(boards, options);
    const double error = c.rig.baseline_mm() - boards.truth.baseline_mm();
    const Eigen::Vector3d t = c.rig.right_from_left.translation_mm.normalized();
    mean.clustered_baseline += error * error / (c.sigma_baseline_mm * c.sigma_baseline_mm) / draws;
    mean.independent_baseline +=
        error * error / t.dot(c.covariance_independent.bottomRightCorner<3, 3>() * t) / draws;
    const auto length = [&](const StereoRig& rig) {
      return Eigen::VectorXd::Constant(1, MeasuredLength(boards.truth, rig));
    };
    mean.clustered_length +=
        std::pow(length(c.rig)[0] - 60, 2) / CalibrationCovariance(c.rig, length)(0, 0) / draws;
  }
  return mean;
}

TEST(Calibrate, SigmasHoldUnderIndependentNoise) {
  SyntheticBoardsOptions made;
  made.pair_count = 14;
  const Consistency mean = Sample(made, 20);
  EXPECT_NEAR(mean.clustered_baseline, 1, 4 * std::sqrt(2.0 / 20));
  EXPECT_NEAR(mean.independent_baseline, 1, 4 * std::sqrt(2.0 / 20));
  EXPECT_NEAR(mean.clustered_length, 1, 4 * std::sqrt(2.0 / 20));
}

TEST(Calibrate, SigmasHoldWhenTheBoardFlexesInTheHandWhereIndependentOnesDoNot) {
  SyntheticBoardsOptions made;
  made.pair_count = 14;
  made.flex_mm = 0.05;
  const Consistency mean = Sample(made, 20);
  EXPECT_NEAR(mean.clustered_baseline, 1, 4 * std::sqrt(2.0 / 20));
  EXPECT_GT(mean.independent_baseline, 3);
}

TEST(Calibrate, ProveSigmas) {
  if (std::getenv("PLUMBLINE_PROVE") == nullptr)
    GTEST_SKIP() << "a long proof: ./bootstrap.sh prove";
  for (const double flex_mm : {0.0, 0.02, 0.05}) {
    SyntheticBoardsOptions made;
    made.flex_mm = flex_mm;
    const Consistency mean = Sample(made, 150);
    std::printf("| %.2f | %.3f | %.3f | %.3f |\n", flex_mm, mean.clustered_baseline,
                mean.clustered_length, mean.independent_baseline);
    EXPECT_NEAR(mean.clustered_baseline, 1, 0.35);
    EXPECT_NEAR(mean.clustered_length, 1, 0.35);
  }
}

TEST(Calibrate, LeavesOutPointsThatAreMisread) {
  SyntheticBoards boards = MakeSyntheticBoards();
  std::mt19937 rng(4);
  std::uniform_int_distribution<std::size_t> photograph(0, boards.pairs.size() - 1), point(0, 40);
  for (int i = 0; i < 20; ++i)
    boards.pairs[photograph(rng)].left.pixels[point(rng)] += Eigen::Vector2d(1.5, -2);
  const Calibration c = CalibrateBoards(boards);
  EXPECT_GE(c.outlier_count, 17);  // the same point may be drawn twice
  EXPECT_LE(c.outlier_count, 22);
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.001);
}

TEST(Calibrate, NamesASwappedPair) {
  SyntheticBoards boards = MakeSyntheticBoards();
  std::swap(boards.pairs[5].left, boards.pairs[5].right);
  const Calibration c = CalibrateBoards(boards);
  EXPECT_FALSE(c.pairs[5].used);
  EXPECT_THAT(c.pairs[5].problem, HasSubstr("swapped"));
  EXPECT_TRUE(c.pairs[4].used);
}

TEST(Calibrate, NamesAPairThatIsNotOfOneMoment) {
  SyntheticBoards boards = MakeSyntheticBoards();
  for (auto& pixel : boards.pairs[7].right.pixels)
    pixel.x() += 3;  // the board moved by half a millimetre in between
  const Calibration c = CalibrateBoards(boards);
  EXPECT_FALSE(c.pairs[7].used);
  EXPECT_THAT(c.pairs[7].problem, HasSubstr("not taken at the same moment"));
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.001);
}

TEST(Calibrate, RefusesPairsThatAreAllOfDifferentMoments) {
  SyntheticBoards boards = MakeSyntheticBoards();
  std::vector<BoardDetection> right;
  for (const auto& p : boards.pairs) right.push_back(p.right);
  for (std::size_t i = 0; i < right.size(); ++i)
    boards.pairs[i].right = right[(i + 5) % right.size()];
  try {
    CalibrateBoards(boards);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), AnyOf(HasSubstr("paired wrongly"), HasSubstr("paired rightly"),
                                HasSubstr("differs from pair to pair")));
  }
}

TEST(Calibrate, NamesAPhotographOfAnotherCamera) {
  SyntheticBoards boards = MakeSyntheticBoards();
  for (auto& pixel : boards.pairs[3].left.pixels)
    pixel = Eigen::Vector2d(640, 480) +
            Eigen::Vector2d(0.5, 0.9).cwiseProduct(pixel - Eigen::Vector2d(640, 480));
  const Calibration c = CalibrateBoards(boards);
  EXPECT_THAT(c.pairs[3].problem, HasSubstr("left: does not fit the camera"));
  EXPECT_EQ(c.pairs[3].left_rms_px, 0);  // its right photograph is still of use
  EXPECT_GT(c.pairs[3].right_rms_px, 0);
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.001);
}

TEST(Calibrate, RefusesBoardsThatAreAllParallel) {
  SyntheticBoardsOptions made;
  made.parallel = true;
  EXPECT_THAT([&] { CalibrateBoards(MakeSyntheticBoards(made)); },
              ::testing::ThrowsMessage<InputError>(HasSubstr("parallel")));
}

TEST(Calibrate, RefusesTooFewPairsAndRepeatsTheDetectorsComplaint) {
  SyntheticBoards boards = MakeSyntheticBoards();
  for (std::size_t i = 3; i < boards.pairs.size(); ++i) {
    boards.pairs[i].left = {};
    boards.pairs[i].left.problem = "found a 7x5 chessboard where 9x7 was asked";
  }
  EXPECT_THAT([&] { CalibrateBoards(boards); },
              ::testing::ThrowsMessage<InputError>(
                  AllOf(HasSubstr("3 of 24 left"), HasSubstr("found a 7x5 chessboard"))));
}

TEST(Calibrate, KnownDistanceSetsTheScaleAndItsMode) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  CalibrationOptions options = Quick();
  options.known_distance =
      KnownDistance{0, 8, 96.96, 0.0097};  // the nominal 96 mm, one percent long
  const Calibration c = CalibrateBoards(boards, options);
  EXPECT_NEAR(c.rig.baseline_mm(), 1.01 * boards.truth.baseline_mm(), 0.05);
  EXPECT_NEAR((c.target_mm[0] - c.target_mm[8]).norm(), 96.96, 1e-9);
  EXPECT_NEAR(c.scale_sigma, 1e-4, 1e-6);
  ASSERT_TRUE(c.rig.modes.has_scale_mode);
  const Eigen::VectorXd last = c.rig.modes.modes.bottomRows<1>().transpose();
  EXPECT_LT((last.tail<3>() - c.scale_sigma * c.rig.right_from_left.translation_mm).norm(), 1e-12);
  EXPECT_EQ(last.head(21).norm(), 0);
  options.known_distance->second_id = 99;
  EXPECT_THROW(CalibrateBoards(boards, options), UsageError);
}

TEST(Calibrate, ModesCarryTheCovarianceOfLengths) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  CalibrationOptions options = Quick();
  options.scale_sigma = 0;
  const Calibration c = CalibrateBoards(boards, options);
  // By the full covariance, linearly: du' C du with the gradient by differences of one tenth of a
  // sigma.
  Eigen::VectorXd gradient(24);
  for (Eigen::Index i = 0; i < 24; ++i) {
    const double h = 0.1 * std::sqrt(c.covariance(i, i));
    Eigen::VectorXd p = c.rig.Parameters();
    p[i] += h;
    const double plus = MeasuredLength(boards.truth, c.rig.WithParameters(p));
    p[i] -= 2 * h;
    gradient[i] = (plus - MeasuredLength(boards.truth, c.rig.WithParameters(p))) / (2 * h);
  }
  const double full = std::sqrt(gradient.dot(c.covariance * gradient));
  const double by_modes = std::sqrt(CalibrationCovariance(c.rig, [&](const StereoRig& rig) {
    return Eigen::VectorXd::Constant(1, MeasuredLength(boards.truth, rig));
  })(0, 0));
  EXPECT_NEAR(by_modes, full, 0.02 * full);
}

TEST(Calibrate, MrcalAgreesThatTheResultIsTheOptimum) {
  SyntheticBoardsOptions made;
  made.board_noise_mm = 0.03;
  const Calibration c = CalibrateBoards(MakeSyntheticBoards(made));
  ASSERT_NE(c.optimization_inputs, nullptr);
  OptimizationInputs inputs = *c.optimization_inputs;
  const auto result = internal::SolveWithMrcal(inputs);
  ASSERT_TRUE(result.usable()) << result.problem;
  EXPECT_NEAR(result.rms_px, c.joint_rms_px, 1e-3 * c.joint_rms_px);
  EXPECT_NEAR(inputs.intrinsics(0, 0), c.rig.left.parameters()[0], 0.05);
}

TEST(Calibrate, AutoPicksTheSimplestModelThatPredictsHeldOutPairs) {
  CalibrationOptions options = Quick();
  options.model.reset();
  const Calibration c = CalibrateBoards(MakeSyntheticBoards(), options);
  EXPECT_EQ(c.model_scores.size(), 3u);
  EXPECT_NE(c.rig.left.model().kind, LensModel::Kind::kOpenCv8);
}

TEST(Calibrate, SplinedLensesAreAsGoodWhereThePhotographsReach) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  CalibrationOptions options = Quick();
  options.model = LensModel::FromName("SPLINED_STEREOGRAPHIC_order=3_Nx=7_Ny=6_fov_x_deg=44");
  options.scale_sigma = 0;
  const Calibration c = CalibrateBoards(boards, options);
  EXPECT_NEAR(c.joint_rms_px, 0.02, 0.0015);
  const auto length = [&](const StereoRig& rig) {
    return Eigen::VectorXd::Constant(1, MeasuredLength(boards.truth, rig));
  };
  const double sigma_mm = std::sqrt(CalibrationCovariance(c.rig, length)(0, 0));
  EXPECT_LT(sigma_mm, 0.02);
  EXPECT_LT(std::abs(length(c.rig)[0] - 60), 4 * sigma_mm);
}

TEST(Calibrate, IsTheSameEveryTime) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  const Calibration a = CalibrateBoards(boards), b = CalibrateBoards(boards);
  EXPECT_EQ(a.rig.Parameters(), b.rig.Parameters());
  EXPECT_EQ(a.covariance, b.covariance);
}

TEST(CalibrationReport, SaysWhatMatters) {
  CalibrationOptions options = Quick();
  options.compare_halves = true;
  SyntheticBoards boards = MakeSyntheticBoards();
  std::swap(boards.pairs[5].left, boards.pairs[5].right);
  const std::string report = CalibrationReport(CalibrateBoards(boards, options));
  for (const char* part :
       {"23 of 24 pairs", "Baseline", "by cross-reprojection (by mrcal's mean-pcam)",
        "Even against odd", "left5 and right5: left and right are swapped", "--known-distance",
        "Would improve it most"}) {
    EXPECT_THAT(report, HasSubstr(part));
  }
}

TEST(BoardAdjustment, JacobiansMatchFiniteDifferences) {
  const SyntheticBoards boards = MakeSyntheticBoards();
  internal::BoardProblem problem{boards.truth,
                                 {Rigid3::FromRotationVector({0.2, -0.3, 0.1}, {-30, -30, 390})},
                                 boards.target_mm,
                                 boards.target_mm,
                                 {},
                                 0,
                                 0};
  for (int camera : {0, 1}) {
    internal::BoardObservation o;
    o.camera = camera;
    o.id = 30;
    o.pixel = {600, 500};
    const auto j = internal::Linearise(problem, o);
    const Eigen::VectorXd lens = (camera == 0 ? problem.rig.left : problem.rig.right).parameters();
    const auto with = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
      internal::BoardProblem p = problem;
      Camera& c = camera == 0 ? p.rig.left : p.rig.right;
      c = c.WithParameters(x.head<9>());
      p.rig.right_from_left = Rigid3::FromRotationVector(x.segment<3>(9), x.segment<3>(12));
      p.left_from_board[0] = Rigid3::FromRotationVector(x.segment<3>(15), x.segment<3>(18));
      p.target_mm[30] = x.tail<3>();
      return internal::Linearise(p, o).residual_px;
    };
    Eigen::VectorXd x(24);
    x << lens, problem.rig.right_from_left.RotationVector(),
        problem.rig.right_from_left.translation_mm, problem.left_from_board[0].RotationVector(),
        problem.left_from_board[0].translation_mm, problem.target_mm[30];
    Eigen::MatrixXd analytic(2, 24);
    analytic << j.intrinsics, j.right_from_left, j.left_from_board, j.target;
    EXPECT_LT((analytic - testing::NumericJacobian(with, x, 1e-5)).norm(), 1e-6 * analytic.norm())
        << camera;
  }
}

}  // namespace
}  // namespace plumbline
