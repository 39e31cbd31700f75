#pragma once

#include <cstdint>
#include <vector>

#include "calib/calibrate.h"

namespace plumbline::testing {

// Photographs of a board as a detector would report them, made from a known rig.
struct SyntheticBoardsOptions {
  BoardSpec board;  // default: chessboard 9x7, 12 mm
  int pair_count = 24;
  double noise_px = 0.02;  // independent, on each coordinate
  double board_noise_mm =
      0;  // the board is misprinted: each point is off by so much, the same in every photograph
  double flex_mm = 0;  // the board flexes in the hand: each pair sees a smooth bend of its own, of
                       // this rms depth
  std::uint64_t board_seed = 7;
  std::uint64_t seed = 1;  // of noise and flex; the geometry is always the same
  bool parallel = false;   // all boards face the left camera squarely

  SyntheticBoardsOptions();
};

struct SyntheticBoards {
  StereoRig truth;
  std::vector<Eigen::Vector3d> target_mm;  // as printed
  std::vector<CalibrationPair> pairs;
};

// Two OPENCV5 cameras of 1280x960 px, 100 mm apart and turned towards each other by 14 degrees,
// boards at 350 to 450 mm.
SyntheticBoards MakeSyntheticBoards(const SyntheticBoardsOptions& options = {});

}  // namespace plumbline::testing
