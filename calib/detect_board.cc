#include <stdexcept>

#include "calib/board.h"
#include "calib/internal/detect_families.h"

namespace plumbline {

BoardDetection DetectBoard(const BoardSpec& spec, const GrayImage& image) {
  if (image.grey.empty() || image.bits < 8 || image.bits > 16) {
    throw std::invalid_argument("DetectBoard: needs an image of 8 to 16 bits");
  }
  switch (spec.kind) {
    case BoardSpec::Kind::kChessboard:
      return internal::DetectChessboard(spec, image);
    case BoardSpec::Kind::kAsymmetricCircles:
    case BoardSpec::Kind::kCircles:
      return internal::DetectCircles(spec, image);
    case BoardSpec::Kind::kDonutDots:
      return internal::DetectDonutDots(spec, image);
    case BoardSpec::Kind::kCharuco:
      return internal::DetectCharuco(spec, image);
    case BoardSpec::Kind::kAprilGrid:
      return internal::DetectAprilGrid(spec, image);
  }
  throw std::invalid_argument("DetectBoard: unknown kind of board");
}

}  // namespace plumbline
