#pragma once

#include <optional>

#include "calib/internal/board_adjustment.h"
#include "calib/optimization_inputs.h"

namespace plumbline::internal {

// The same problem in the form that libmrcal solves: a flat board that is a regular grid.
// Observations are those of the inliers, with the disc offsets and the target's departures from its
// nominal shape folded in (observed - predicted(target) + predicted(nominal)), so that mrcal's
// residuals are ours. Empty where the board is no regular grid.
std::optional<OptimizationInputs> ToOptimizationInputs(const BoardProblem& problem);

// Takes cameras, poses and outlier marks of a solve of what ToOptimizationInputs made from this
// problem.
void TakeSolution(const OptimizationInputs& solved, BoardProblem& problem);

}  // namespace plumbline::internal
