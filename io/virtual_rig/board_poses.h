#pragma once

#include <cstdint>
#include <numbers>
#include <vector>

#include "calib/board.h"
#include "calib/rigid3.h"
#include "calib/stereo_rig.h"
#include "io/virtual_rig/board_albedo.h"

namespace plumbline {

struct BoardPoseOptions {
  enum class Style {
    kCareful,   // all over both images, near and far, tilted in all directions
    kCareless,  // nearly frontal, always about the middle, at one distance
  };

  Style style = Style::kCareful;
  int count = 30;
  // Of the pattern's middle from the left camera, along its axis. Both are required.
  double min_distance_mm = 0;
  double max_distance_mm = 0;
  // Between the board's normal and the mean of the two cameras' axes; careful style only.
  double min_tilt_rad = 20 * std::numbers::pi / 180;
  double max_tilt_rad = 40 * std::numbers::pi / 180;
  // What must be seen stays so far inside the images.
  double edge_margin_px = 8;
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Where somebody holds a board in front of a rig for calibration: left_from_board of each pair of
// photographs, the board's front towards the cameras, its rows along the images' rows but for some
// roll. The first pose is frontal (normal along the mean of the two axes) in the middle of the
// common field.
//
// kCareful: distances and directions of tilt are spread evenly; each pose is the one, of 24 random
// ones, that shows the most points where the images had the fewest. kCareless: tilts below 8
// degrees, about the middle, distances within 2 %.
//
// A board that detection needs whole (chessboard, circles, acircles) is whole in both images,
// pattern and all. Of donut-dots, charuco and aprilgrid every other careful pose may stick out of
// the images: 60 % of the points are in each, and the three rings. No camera sees the middle of the
// board at more than 60 degrees off its normal, nor the board so small that it would not be found:
// squares under 7 px, discs under 6, holes of rings under 2.4, modules of ChArUco markers under 1.6
// or of AprilGrid tags under 2, each where it is narrowest. Rolls stay within 30 degrees (25 for
// boards that look the same after half a turn, 10 after a quarter). Glare, focus and bending are
// not looked at.
//
// Throws InputError when no pose can be drawn: the board is too large or too small for this rig at
// these distances, or the cameras have no field in common. UsageError as BoardPoseOptions::Check()
// and BoardPrint::Check().
//
// The same options give the same poses. Pure and thread-safe.
// Accuracy: tests/io/virtual_rig/board_poses_test.cc (of all poses of eleven boards in two rigs, 99
// % of the rendered photographs are detected).
std::vector<Rigid3> DrawBoardPoses(const StereoRig& rig, const BoardSpec& spec,
                                   const BoardPrint& print, const BoardPoseOptions& options);

}  // namespace plumbline
