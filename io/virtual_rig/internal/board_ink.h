#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "calib/board.h"

namespace plumbline::internal {

// A soft edge: 0 well below zero, 1 well above, 3 t^2 - 2 t^3 in between.
class EdgeRamp {
 public:
  explicit EdgeRamp(double width_mm) : per_width_(1 / width_mm) {}
  double operator()(double distance_mm) const {
    const double t = distance_mm * per_width_ + 0.5;
    return t <= 0 ? 0 : t >= 1 ? 1 : t * t * (3 - 2 * t);
  }

 private:
  double per_width_;
};

// The bits of all markers of a board, as printed upright: count x size x size, row by row, 1 is
// white.
struct MarkerBits {
  int size = 0;
  std::vector<std::uint8_t> white;

  // Beyond its border a marker is surrounded by white.
  int At(int marker, int column, int row) const {
    if (column < 0 || row < 0 || column >= size || row >= size) return 1;
    return white[static_cast<std::size_t>((marker * size + row) * size + column)];
  }
};

// Share of white at a place within marker modules of module_mm; (x_mm, y_mm) from the marker's top
// left corner. Each border between unlike modules is a soft edge.
double MarkerWhite(const MarkerBits& bits, int marker, double module_mm, const EdgeRamp& ramp,
                   double x_mm, double y_mm);

// Black borders one module wide, as OpenCV draws them.
MarkerBits ArucoBits(const BoardSpec& spec);

// Which marker is in which square (row by row); -1 in the black ones.
std::vector<int> MarkerOfSquare(const BoardSpec& spec);

// Black borders two modules wide, as Kalibr prints them.
MarkerBits KalibrTagBits(const BoardSpec& spec);

// Modules along the side of a marker, border included. Needs a board with markers.
int ModulesPerSide(const BoardSpec& spec);

}  // namespace plumbline::internal
