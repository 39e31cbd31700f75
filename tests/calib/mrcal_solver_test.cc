#include "calib/internal/mrcal_solver.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"
#include "tests/support/synthetic_calibration.h"

namespace plumbline::internal {
namespace {

using ::plumbline::testing::MakeSyntheticCalibration;
using ::plumbline::testing::SyntheticCalibrationOptions;

// Moves every parameter a little away from where it is.
void Perturb(OptimizationInputs& inputs) {
  inputs.intrinsics.leftCols<2>().array() *= 1.03;
  inputs.intrinsics.middleCols<2>(2).array() += 9;
  inputs.intrinsics.rightCols(inputs.intrinsics.cols() - 4).setZero();
  inputs.extrinsics_rt_fromref.array() += 0.01;
  inputs.frames_rt_toref.array() += 0.01;
}

// The state, packed by libmrcal's scaling, put back into the inputs.
OptimizationInputs WithState(const OptimizationInputs& inputs, const StateLayout& s,
                             const Eigen::VectorXd& b) {
  OptimizationInputs out = inputs;
  for (int c = 0; c < inputs.camera_count(); ++c) {
    out.intrinsics.row(c) =
        b.segment(s.intrinsics + c * s.intrinsics_per_camera, s.intrinsics_per_camera).transpose();
  }
  for (Eigen::Index e = 0; e < inputs.extrinsics_rt_fromref.rows(); ++e) {
    out.extrinsics_rt_fromref.row(e) = b.segment<6>(s.extrinsics + 6 * e).transpose();
  }
  for (Eigen::Index f = 0; f < inputs.frames_rt_toref.rows(); ++f) {
    out.frames_rt_toref.row(f) = b.segment<6>(s.frames + 6 * f).transpose();
  }
  if (s.calobject_warp >= 0) out.calobject_warp = b.segment<2>(s.calobject_warp);
  return out;
}

TEST(SolveWithMrcal, RecoversTheTruthFromPerfectObservations) {
  const OptimizationInputs truth = MakeSyntheticCalibration();
  OptimizationInputs inputs = truth;
  Perturb(inputs);
  const MrcalSolveResult result = SolveWithMrcal(inputs);
  EXPECT_TRUE(result.usable()) << result.problem;
  EXPECT_LT(result.rms_px, 1e-6);
  EXPECT_EQ(result.new_outlier_count, 0);
  EXPECT_LT((inputs.intrinsics - truth.intrinsics).cwiseAbs().maxCoeff(), 1e-3);
  EXPECT_LT((inputs.extrinsics_rt_fromref - truth.extrinsics_rt_fromref).norm(), 1e-6);
}

TEST(SolveWithMrcal, RmsIsTheNoiseOfOneCoordinateAndWrongCornersAreThrownOut) {
  SyntheticCalibrationOptions options;
  options.noise_px = 0.1;
  const OptimizationInputs truth = MakeSyntheticCalibration(options);
  OptimizationInputs inputs = truth;
  inputs.do_apply_outlier_rejection = true;
  std::vector<Eigen::Index> wrong;
  for (Eigen::Index row = 40; row < inputs.observations_board.rows(); row += 211) {
    if (inputs.observations_board(row, 2) < 0) continue;
    inputs.observations_board(row, 0) += 5;
    wrong.push_back(row);
  }
  ASSERT_GT(wrong.size(), 5u);
  const MrcalSolveResult result = SolveWithMrcal(inputs);
  EXPECT_TRUE(result.usable()) << result.problem;
  EXPECT_NEAR(result.rms_px, 0.1, 0.01);
  for (const Eigen::Index row : wrong) EXPECT_LT(inputs.observations_board(row, 2), 0) << row;
  EXPECT_LT(result.new_outlier_count, static_cast<int>(wrong.size()) + 60);
  EXPECT_EQ(result.inlier_count + result.outlier_count,
            static_cast<int>(inputs.observations_board.rows()));
}

TEST(SolveWithMrcal, ACollapsedProblemIsReportedAsAProblem) {
  OptimizationInputs inputs = MakeSyntheticCalibration();
  for (Eigen::Index i = 0; i < inputs.observations_board.rows(); ++i) {
    inputs.observations_board.row(i) << 100, 100, 1;  // every corner at one place
  }
  EXPECT_FALSE(SolveWithMrcal(inputs).usable());
  inputs = MakeSyntheticCalibration();
  inputs.observations_board.col(2).setConstant(-1);  // no inlier: libmrcal says rms 0
  EXPECT_FALSE(SolveWithMrcal(inputs).usable());
  SyntheticCalibrationOptions one;
  one.pair_count = 1;
  one.board_columns = one.board_rows = 2;
  inputs = MakeSyntheticCalibration(one);
  EXPECT_NE(SolveWithMrcal(inputs).problem.find("more unknowns"), std::string::npos);
}

TEST(SolveWithMrcal, RefusesInconsistentInputs) {
  const OptimizationInputs good = MakeSyntheticCalibration();
  OptimizationInputs inputs = good;
  inputs.indices_frame_camintrinsics_camextrinsics(3, 1) = 7;
  EXPECT_THROW(SolveWithMrcal(inputs), InputError);
  inputs = good;
  inputs.observations_board(5, 0) = std::nan("");
  EXPECT_THROW(SolveWithMrcal(inputs), InputError);
  inputs = good;
  inputs.indices_frame_camintrinsics_camextrinsics.row(0).swap(
      inputs.indices_frame_camintrinsics_camextrinsics.row(4));
  EXPECT_THROW(SolveWithMrcal(inputs), InputError);
  inputs = good;
  inputs.board_rows = 6;
  EXPECT_THROW(SolveWithMrcal(inputs), InputError);
}

class OptimizerCallbackOf : public ::testing::TestWithParam<LensModel::Kind> {};

TEST_P(OptimizerCallbackOf, JacobianMatchesFiniteDifferencesInUnpackedUnits) {
  SyntheticCalibrationOptions options;
  options.model = GetParam();
  options.pair_count = 3;
  options.board_columns = options.board_rows = 4;
  options.noise_px = 0.3;
  OptimizationInputs inputs = MakeSyntheticCalibration(options);
  inputs.calobject_warp = Eigen::Vector2d(1e-4, -2e-4);
  inputs.do_optimize_calobject_warp = true;
  inputs.do_apply_regularization = true;
  inputs.observations_board.row(7) << -1, -1, -1;
  inputs.observations_board(9, 2) = 0.5;
  const OptimizerState at = OptimizerCallback(inputs);
  ASSERT_EQ(at.x.size(), at.layout.board_measurements + at.layout.regularization_measurements);
  const Eigen::VectorXd b = at.b_packed.cwiseProduct(at.unpack_scale);
  const Eigen::MatrixXd numeric = testing::NumericJacobian(
      [&](const Eigen::VectorXd& b_packed) -> Eigen::VectorXd {
        return OptimizerCallback(
                   WithState(inputs, at.layout, b_packed.cwiseProduct(at.unpack_scale)))
            .x;
      },
      at.b_packed, 1e-5);
  EXPECT_LT((Eigen::MatrixXd(at.J) - numeric).cwiseAbs().maxCoeff(),
            2e-6 * numeric.cwiseAbs().maxCoeff());
  EXPECT_EQ(at.x.segment<2>(14).norm(), 0);  // corner 7 takes no part
}

INSTANTIATE_TEST_SUITE_P(MrcalSolver, OptimizerCallbackOf,
                         ::testing::Values(LensModel::Kind::kOpenCv4, LensModel::Kind::kOpenCv8,
                                           LensModel::Kind::kSplinedStereographic));

}  // namespace
}  // namespace plumbline::internal
