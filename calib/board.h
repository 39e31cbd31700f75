#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// A calibration target, named by one word. Lengths carry a unit (mm, cm or m):
//
//   chessboard:12x8:5mm      inner corners across x down, side of a square
//   acircles:4x11:20mm       asymmetric circles, OpenCV's layout: discs in a row x rows, half the
//                            distance between neighbours of a row; disc (c, r) lies at
//                            ((2 c + r % 2) p, r p)
//   circles:14x10:7mm        symmetric circles across x down, pitch. One disc with at least twice
//                            the area of the others marks column 0 of the last row
//   donut-dots:14x10:7mm     dots across x down, pitch; three of them are rings: see MarkersOf()
//   charuco:5x7:36.2mm:18.3mm:DICT_6X6_250
//                            squares across x down, side of a square, side of a marker, OpenCV's
//                            name of the dictionary; points are the inner corners of the squares
//   aprilgrid:6x6:88mm:0.3:tag36h11
//                            tags across x down, side of a tag, gap / side, family. Kalibr's
//                            layout: tag 0 at the bottom left, numbered along the rows, upwards
struct BoardSpec {
  enum class Kind { kChessboard, kAsymmetricCircles, kCircles, kDonutDots, kCharuco, kAprilGrid };

  Kind kind = Kind::kChessboard;
  int columns = 0;
  int rows = 0;
  double pitch_mm = 0;       // square, dot pitch or tag size
  double marker_mm = 0;      // ChArUco
  double spacing_ratio = 0;  // AprilGrid
  std::string dictionary;    // ChArUco, AprilGrid

  // Throws UsageError naming what is wrong in the word and showing a right one.
  static BoardSpec Parse(std::string_view word);
  // The word that Parse() reads back to the same board, lengths in mm.
  std::string Word() const;

  // Whether its points are discs, whose image centroid is not the image of their centre.
  bool HasDiscs() const {
    return kind == Kind::kAsymmetricCircles || kind == Kind::kCircles || kind == Kind::kDonutDots;
  }

  // Points are numbered row by row from 0, columns (of points) first. AprilGrid: id = 4 tag +
  // corner, corners of an upright tag: bottom left, bottom right, top right, top left (Kalibr's
  // order).
  int PointCount() const;

  // Nominal place of a point in the board frame (mm): x along a row, y down the rows, z = 0 on the
  // surface and pointing into the board (away from the camera), so that (x, y, z) is right-handed
  // and the board's pose in a camera is near identity. Point 0 is the origin, except for AprilGrid,
  // whose origin is the top left corner of its top left tag.
  // Throws std::out_of_range on an id that the board does not have.
  Eigen::Vector3d NominalPoint(int id) const;

  // How many of the four quarter turns in its plane leave the board looking the same: 4, 2 or 1.
  // With 1, a photograph alone tells which point is which. With more, detection takes the turn that
  // brings the rows nearest to the rows of the image (x to the right), because boards in the hand
  // are tilted and rolled a little but not turned over, and refuses where that is not clear: see
  // DetectBoard(). A big corner disc on a `circles` board makes it unambiguous.
  int SymmetryOrder() const;

  // The point that takes the place of `id` when the board is turned by half a turn in its plane.
  // For symmetric boards seen by a camera that is mounted upside down. Empty where the turned board
  // looks different.
  std::optional<int> HalfTurnId(int id) const;

  friend bool operator==(const BoardSpec&, const BoardSpec&) = default;
};

// Where a donut-dots board has its rings, as point ids. VIC-3D and DICe count rows upwards from the
// bottom left and put the origin ring at their (2, 2), counted from 0. In the order of our ids
// (rows downwards) that is column 2 of row rows - 3; the x marker is column columns - 3 of the same
// row, the y marker is row 2 of the same column. For 14x10 these are DICe's tenth dot along x and
// sixth along y, the origin counted as the first.
struct DonutMarkers {
  int origin = 0;
  int along_x = 0;
  int along_y = 0;
};
// Throws std::invalid_argument on a board of another kind.
DonutMarkers MarkersOf(const BoardSpec& spec);

// What one photograph shows of a board.
struct BoardDetection {
  std::vector<int> ids;                 // ascending, each once
  std::vector<Eigen::Vector2d> pixels;  // raw image; discs: centroid of the disc's image
  std::vector<double> sigma_px;         // one standard deviation of each coordinate
  double disc_radius_mm = 0;            // estimated from the image; 0 where the board has no discs
  std::string problem;                  // empty, or one sentence saying why there are no points

  bool found() const { return !ids.empty(); }
};

// Finds the board in one photograph.
//
// Points: chessboard, ChArUco and AprilGrid corners by a least-squares fit of a blurred saddle
// (two crossing edges) to the grey values; discs by a fit of a blurred ellipse with planes for the
// bright and the dark level, so that neither shading nor blur moves the centre. sigma_px comes from
// the fit's normal matrix and its residuals; it is the repeatability of the point under image
// noise, not the print quality of the board. Every point was fitted; none is filled in.
//
// Part of a board is enough for donut-dots (with its three rings in view), charuco and aprilgrid;
// the other kinds must be in the image as a whole.
//
// Orientation: never guessed. Rings, tags, a big corner disc, and the colours of a chessboard with
// one odd and one even count decide it (its first square, the one between the points 0, 1,
// columns, columns + 1, is black). The remaining symmetric boards are taken with their rows along
// the image's rows: the turn is accepted when the next best one is at least 20 degrees further
// from the image's axes, and refused with a `problem` otherwise. So the same physical point has the
// same id in both cameras of a pair and in all photographs, as long as nobody turns the board over
// and the cameras are not rolled against each other by more than about 70 degrees (20 for boards
// with four-fold symmetry). See BoardSpec::HalfTurnId() for the rest.
//
// Never throws on what an image shows. Throws std::invalid_argument on an empty image or bits
// outside 8 to 16. Pure and thread-safe (OpenCV's own threads aside).
BoardDetection DetectBoard(const BoardSpec& spec, const GrayImage& image);

}  // namespace plumbline
