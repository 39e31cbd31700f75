#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "calib/image.h"

namespace plumbline::internal {

// Where two edges cross and four quadrants alternate between bright and dark.
struct SaddleFit {
  Eigen::Vector2d pixel;
  Eigen::Matrix2d cov_px2;          // residual variance times the normal matrix's inverse
  std::array<double, 2> angle_rad;  // directions of the two edges, in [0, pi) apart
  bool dark_between = false;        // whether the quadrant between direction 0 and 1 is dark
  double blur_px = 0;
  double contrast = 0;  // grey levels
  double residual = 0;  // rms, grey levels
};

// Fits two crossing blurred edges with planes for the bright and the dark level to the pixels in a
// disc of `radius_px` around `start`: share = (1 + e1 e2) / 2, e_k = erf(n_k (p - c) / (sqrt(2)
// s)). `direction0`, `direction1` are rough directions of the edges from the point (any length).
//
// Nothing when the window leaves the image by more than a quarter, the fit does not converge, moves
// by more than half the radius, or fits worse than a quarter of the contrast.
// Pure and thread-safe. Accuracy: tests/calib/detect_chessboard_test.cc.
std::optional<SaddleFit> FitSaddle(const GrayImage& image, const Eigen::Vector2d& start,
                                   const Eigen::Vector2d& direction0,
                                   const Eigen::Vector2d& direction1, double radius_px);

}  // namespace plumbline::internal
