#pragma once

#include <Eigen/Core>

#include "calib/internal/board_adjustment.h"

namespace plumbline::internal {

// Covariance of the rig's parameters (order of StereoRig::Parameters) at the minimum of a
// BoardProblem.
struct RigCovariance {
  Eigen::MatrixXd clustered;    // residuals of one pair of photographs may be correlated in any way
  Eigen::MatrixXd independent;  // all residuals independent
  double shrinkage = 0;         // weight of the independent shape in `clustered`, 0 to 1
};

// Board poses and, where it is free, the target are marginalised out. The target's similarity
// transforms are held: six belong to the choice of the board frame, and the seventh, the scale, is
// reported as a mode of its own.
//
// `independent` is s^2 S^-1, with S the information of cameras and target after elimination of the
// poses. `clustered` is the delete-one-pair jackknife in its linear form, delta_g = -(S - S_g)^-1
// g_g, times (G - 1) / G (Bell and McCaffrey 2002, CR3), whitened by `independent` and shrunk
// towards a multiple of it with the weight of Ledoit and Wolf (J. Multivariate Analysis 88, 2004),
// because with few pairs the jackknife alone leaves directions without variance.
RigCovariance ClusteredCovariance(const BoardProblem& problem, bool target_free,
                                  double target_sigma_mm);

}  // namespace plumbline::internal
