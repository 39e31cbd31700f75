#pragma once

#include <cstdint>

#include "calib/optimization_inputs.h"

namespace plumbline::testing {

// A perfect calibration with known truth: two cameras that look at a flat board in random poses.
struct SyntheticCalibrationOptions {
  LensModel::Kind model = LensModel::Kind::kOpenCv5;
  int pair_count = 20;
  int board_columns = 9;
  int board_rows = 7;
  double noise_px = 0;     // one standard deviation of each coordinate
  std::uint64_t seed = 1;  // of the noise; the geometry is always the same
};

// At the truth, with noise on the observations: camera 0 is the reference, camera 1 stands 0.1 m to
// its right, turned towards it; boards of 12 mm squares at 0.3 to 0.5 m fill the image. No
// outliers, no regularization, no warp.
OptimizationInputs MakeSyntheticCalibration(const SyntheticCalibrationOptions& options = {});

// The same observations seen from other noise: projections of the truth in `perfect`, plus noise.
void SetObservations(const OptimizationInputs& perfect, double noise_px, std::uint64_t seed,
                     OptimizationInputs& inputs);

}  // namespace plumbline::testing
