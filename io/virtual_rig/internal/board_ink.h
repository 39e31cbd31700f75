#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "calib/board.h"

namespace plumbline::internal {

// std::floor for what an int can hold, without a call: the patterns ask for it at every sample.
inline int FloorToInt(double x) {
  const int k = static_cast<int>(x);
  return k > x ? k - 1 : k;
}

inline int NearestInt(double x) { return FloorToInt(x + 0.5); }

// What is printed at a place: a share of 0 to 1, which is the same to the bit at less than same_mm
// from there. Not above 0: nothing is known of the places around.
struct Shade {
  double share;
  double same_mm;
};

// A soft edge: 0 well below zero, 1 well above, 3 t^2 - 2 t^3 in between.
class EdgeRamp {
 public:
  explicit EdgeRamp(double width_mm) : per_width_(1 / width_mm), reach_mm_(width_mm / 2) {}
  double operator()(double distance_mm) const {
    const double t = distance_mm * per_width_ + 0.5;
    return t <= 0 ? 0 : t >= 1 ? 1 : t * t * (3 - 2 * t);
  }
  // How far it is from such a distance to where the ramp is neither 0 nor 1.
  double Clear(double distance_mm) const { return std::abs(distance_mm) - reach_mm_; }
  // The same for a row of edges step_mm apart, one of them at 0.
  double ClearOfRow(double place_mm, double step_mm) const {
    return Clear(place_mm - NearestInt(place_mm / step_mm) * step_mm);
  }

 private:
  double per_width_;
  double reach_mm_;
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

// The white at a place within marker modules of module_mm; (x_mm, y_mm) from the marker's top left
// corner. Each border between unlike modules is a soft edge.
Shade MarkerWhite(const MarkerBits& bits, int marker, double module_mm, const EdgeRamp& ramp,
                  double x_mm, double y_mm);

// Black borders one module wide, as OpenCV draws them.
MarkerBits ArucoBits(const BoardSpec& spec);

// Which marker is in which square (row by row); -1 in the black ones.
std::vector<int> MarkerOfSquare(const BoardSpec& spec);

// The first tags of an AprilTag family, and how many it has. The family as the apriltag library
// calls it.
MarkerBits TagBits(const std::string& family, int count, int border_modules);
int TagsOfFamily(const std::string& family);

// Black borders two modules wide, as Kalibr prints them.
MarkerBits KalibrTagBits(const BoardSpec& spec);

// Modules along the side of a marker, border included. Needs a board with markers.
int ModulesPerSide(const BoardSpec& spec);

}  // namespace plumbline::internal
