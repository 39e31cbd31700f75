#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// A calibration target, named by one word:
//
//   chessboard:12x8:5mm                        inner corners across x down, square size
//   acircles:4x11:20mm                         asymmetric circles, OpenCV's layout; distance
//   between neighbours in a row is 2 x
//                                              the given half pitch: point (c, r) lies at ((2 c + r
//                                              % 2) p, r p)
//   circles:14x10:7mm                          symmetric circles, pitch
//   donut-dots:14x10:7mm                       dots, pitch; three of them are rings (see board.cc
//   for where) charuco:5x7:36.2mm:18.3mm:DICT_6X6_250     squares across x down, square, marker,
//   dictionary aprilgrid:6x6:88mm:0.3:tag36h11            tags across x down, tag size, spacing /
//   tag size, family (Kalibr's layout)
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
  std::string Word() const;

  // Whether its points are discs, whose image centroid is not the image of their centre.
  bool HasDiscs() const {
    return kind == Kind::kAsymmetricCircles || kind == Kind::kCircles || kind == Kind::kDonutDots;
  }

  // Points are numbered row by row from 0; AprilGrid: 4 a tag, in Kalibr's corner order.
  int PointCount() const;

  // Nominal place of a point in the board frame (mm): x along a row, y down the rows, z = 0 on the
  // surface and pointing into the board (away from the camera), so that (x, y, z) is right-handed
  // and the board's pose in a camera is near identity.
  Eigen::Vector3d NominalPoint(int id) const;
};

// What one photograph shows of a board.
struct BoardDetection {
  std::vector<int> ids;                 // ascending, each once
  std::vector<Eigen::Vector2d> pixels;  // raw image; discs: centroid of the disc's image
  std::vector<double> sigma_px;         // one standard deviation of each coordinate
  double disc_radius_mm = 0;            // estimated from the image; 0 where the board has no discs
  std::string problem;                  // empty, or one sentence saying why there are no points

  bool found() const { return !ids.empty(); }
};

// Finds the board in one photograph. Never guesses an orientation: what is ambiguous is refused
// with a `problem`. Pure and thread-safe (OpenCV's own threads aside).
BoardDetection DetectBoard(const BoardSpec& spec, const GrayImage& image);

}  // namespace plumbline
