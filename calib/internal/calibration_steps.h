#pragma once

#include <vector>

#include "calib/calibrate.h"
#include "calib/internal/board_adjustment.h"
#include "calib/internal/calibration_seed.h"

namespace plumbline::internal {

// From the seed to a solution good enough to tell outliers: by libmrcal where the board is a
// regular grid, else by a joint adjustment with a robust loss.
void SolveRobustly(BoardProblem& problem);

// The joint adjustment to convergence: disc offsets, outliers and the noise floor are found in
// turns with it.
void Refine(BoardProblem& problem, const CalibrationOptions& options, bool rigid_target);

// Takes pairs out whose residuals are far above the others', saying why, and refines again (with a
// rigid board).
void DropBadPairs(CalibrationSeed& seed, const CalibrationOptions& options);

// The same problem solved from every second pair in use, beginning with the `first`-th (0 or 1).
BoardProblem Half(const BoardProblem& problem, int first, const CalibrationOptions& options);

// What is left between two sets of points (columns, mm) once the similarity transform that fits
// `from` best to `to` is applied.
Eigen::Matrix3Xd DepartureFromSimilar(const Eigen::Matrix3Xd& from, const Eigen::Matrix3Xd& to);

// RMS per component between the targets of two solutions, a similarity transform taken out, mm.
double TargetDifference(const BoardProblem& a, const BoardProblem& b);

// Held-out residuals of each lens model, by 4-fold cross-validation over pairs: cameras and target
// from the other pairs, only the pose of the held-out board is fitted.
std::vector<ModelScore> ScoreModels(const BoardSpec& board, ImageSize left_size,
                                    ImageSize right_size, const std::vector<CalibrationPair>& pairs,
                                    const CalibrationOptions& options);

// The model with the fewest parameters that is not worse than the best by more than one standard
// error.
LensModel SimplestOfTheBest(const std::vector<ModelScore>& scores);

}  // namespace plumbline::internal
