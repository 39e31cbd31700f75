#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <string>

#include "calib/optimization_inputs.h"

namespace plumbline::internal {

// What a solve by libmrcal came to.
struct MrcalSolveResult {
  // Empty when the optimum can be used; else one sentence saying why not. libmrcal itself reports
  // success also for collapsed problems.
  std::string problem;
  double rms_px = 0;      // of the scalar board residuals of the inliers, regularization left out
  int outlier_count = 0;  // corners with a negative weight after the solve ...
  int new_outlier_count = 0;  // ... of which so many were thrown out by it
  int inlier_count = 0;       // corners
  bool usable() const { return problem.empty(); }
};

// Solves in place by mrcal_optimize(): intrinsics, extrinsics, frames, points and warp become the
// optimum, new outliers (where do_apply_outlier_rejection) get a negative weight.
//
// The result is judged here, because libmrcal has no convergence status: it must be finite, each
// camera must have a focal length between 0.1 and 1000 image widths, its principal point may not
// leave the image by more than one image width, and at least 4 corners a board observation on
// average and half of what went in must be left as inliers.
//
// Throws InputError if the inputs are not consistent (OptimizationInputs::Check).
MrcalSolveResult SolveWithMrcal(OptimizationInputs& inputs);

// Where things lie in the state and measurement vectors of one problem; -1 where not solved for.
struct StateLayout {
  int state_count = 0;
  int intrinsics_per_camera = 0;  // optimised parameters of one camera
  int first_intrinsic = 0;        // index of the first optimised one within the camera's parameters
  int intrinsics = -1;            // of camera 0; camera c follows at + c * intrinsics_per_camera
  int extrinsics = -1;            // 6 a pose
  int frames = -1;                // 6 a board pose
  int points = -1;                // 3 a point
  int calobject_warp = -1;        // 2

  int measurement_count = 0;
  int board_measurements = 0;  // first rows: 2 a corner, in the order of observations_board
  int point_measurements = 0;  // after them
  int regularization_measurements = 0;  // last
};
StateLayout LayoutOf(const OptimizationInputs& inputs);

// The optimiser's cost function at the inputs as they are.
struct OptimizerState {
  StateLayout layout;
  Eigen::VectorXd x;                               // residuals (measurements)
  Eigen::SparseMatrix<double, Eigen::RowMajor> J;  // d x / d b_packed (measurements, states)
  Eigen::VectorXd b_packed;                        // state in the optimiser's scaling
  // b = unpack_scale .* b_packed, so that dF/db_packed = dF/db .* unpack_scale.
  Eigen::VectorXd unpack_scale;
};

// mrcal_optimizer_callback(). Throws InputError as SolveWithMrcal.
OptimizerState OptimizerCallback(const OptimizationInputs& inputs);

}  // namespace plumbline::internal
