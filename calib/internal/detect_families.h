#pragma once

#include "calib/board.h"

namespace plumbline::internal {

// One detector a family of boards; DetectBoard() picks. Each returns the points, or a problem.
BoardDetection DetectChessboard(const BoardSpec& spec, const GrayImage& image);
BoardDetection DetectCircles(const BoardSpec& spec, const GrayImage& image);  // acircles too
BoardDetection DetectDonutDots(const BoardSpec& spec, const GrayImage& image);
BoardDetection DetectCharuco(const BoardSpec& spec, const GrayImage& image);
BoardDetection DetectAprilGrid(const BoardSpec& spec, const GrayImage& image);

// A detection that found nothing, and why.
inline BoardDetection NotFound(std::string problem) {
  BoardDetection out;
  out.problem = std::move(problem);
  return out;
}

}  // namespace plumbline::internal
