#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>

#include "calib/board.h"
#include "io/virtual_rig/albedo.h"

namespace plumbline {

// How a board is printed. Albedos are 0 (black) to 1 (white); lengths are mm on the board.
struct BoardPrint {
  double black = 0.05;
  double white = 0.9;
  double background = 0.3;  // what is seen beyond the sheet
  // Edges are smooth ramps (3 t^2 - 2 t^3) of this width, centred on the edge.
  double edge_mm = 0.05;
  // White around the pattern. Left out: one square or pitch, as the detectors ask for; for an
  // AprilGrid one gap between its tags.
  std::optional<double> margin_mm;

  // Discs only, see BoardSpec::HasDiscs().
  double disc_share = 0.27;      // radius / distance between neighbouring discs
  double hole_share = 0.4;       // donut-dots: radius of a ring's hole / radius of the disc
  bool big_corner_disc = false;  // circles: 1.8 times the radius in column 0 of the last row
  bool white_on_black = false;   // the margin is black too

  // Throws UsageError naming the broken constraint: edges that run into each other, discs that
  // touch, options of discs on a board without any.
  void Check(const BoardSpec& spec) const;
};

// The corners of a rectangle on the board, in the board frame of BoardSpec::NominalPoint() (mm):
// top left, top right, bottom right, bottom left.
using BoardRectangle = std::array<Eigen::Vector2d, 4>;

// Around all that is printed: the outer squares of a chessboard, the rims of the discs, the outer
// black squares of an AprilGrid.
BoardRectangle PatternOutline(const BoardSpec& spec, const BoardPrint& print);

// The sheet that it is printed on: the pattern and its margin.
BoardRectangle BoardOutline(const BoardSpec& spec, const BoardPrint& print);

// Radius (mm) of the disc with this id, the big corner disc included; 0 where the board has none.
double PrintedDiscRadius(const BoardSpec& spec, const BoardPrint& print, int id);

// The printed pattern of a board as a formula of the board coordinates: material (u, v) = (x, y) of
// BoardSpec::NominalPoint(), mm, the board seen from its front. The pattern is the ideal one;
// BoardSurface bends and misprints it.
//
// ChArUco: OpenCV 4.6's layout, the top left square is black. AprilGrid: as Kalibr prints it, black
// borders two modules wide and black squares in the gaps, also around the outer tags. The bits of
// the markers are OpenCV's and the apriltag library's.
//
// Evaluate() allocates nothing; not finite coordinates are background.
// Throws UsageError as BoardPrint::Check().
// Accuracy: tests/io/virtual_rig/board_albedo_test.cc (every kind of board is detected within
// 0.01 px of the truth).
std::unique_ptr<const Albedo> MakeBoardAlbedo(const BoardSpec& spec, const BoardPrint& print = {});

}  // namespace plumbline
