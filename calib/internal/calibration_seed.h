#pragma once

#include <string>
#include <vector>

#include "calib/calibrate.h"
#include "calib/internal/board_adjustment.h"

namespace plumbline::internal {

// A first calibration, good to a few pixels, and which pairs of photographs cannot be part of it.
struct CalibrationSeed {
  BoardProblem problem;                    // the observations of the pairs that are used
  std::vector<std::string> pair_problems;  // a pair: why it, or one of its photographs, is left out
};

// Each camera alone by OpenCV (principal point in the middle, one distortion term), then the right
// camera against the left from the pairs that both see, by the pair that agrees best with the
// others. Names pairs that are swapped, unsynchronised or of another camera. Throws InputError when
// no calibration can come of it.
CalibrationSeed SeedCalibration(const BoardSpec& board, const LensModel& model, ImageSize left_size,
                                ImageSize right_size, const std::vector<CalibrationPair>& pairs);

// Angle between the most different board orientations, in radians.
double OrientationSpread(const BoardProblem& problem);

}  // namespace plumbline::internal
