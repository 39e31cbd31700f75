#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

#include "io/virtual_rig/internal/smooth_step.h"
#include "io/virtual_rig/tyre_surface.h"

namespace plumbline::internal {

// r(s) and y(s) over arc length s from the crown's centre (mm), s > 0 towards +y. A C2 spline of
// fifth degree through points integrated from the curvature every millimetre; the spline is the
// shape. Symmetric in s.
class Meridian {
 public:
  explicit Meridian(const TyreSection& options);

  template <typename T>
  struct Point {
    T radius_mm, y_mm;
  };
  template <typename T>
  Point<T> At(const T& s) const;

  // From the inner to the outer surface, along the normal.
  template <typename T>
  T Thickness(const T& s) const {
    using std::abs;
    const T a = abs(s);
    return options_.crown_thickness_mm +
           (options_.shoulder_thickness_mm - options_.crown_thickness_mm) *
               SmoothStep(T((a - (options_.shoulder_begin_mm - 10)) / 30.0)) +
           (options_.sidewall_thickness_mm - options_.shoulder_thickness_mm) *
               SmoothStep(T((a - (options_.sidewall_begin_mm + 26)) / 60.0));
  }

  const TyreSection& options() const { return options_; }
  double outer_radius_mm() const { return options_.crown_radius_mm + options_.crown_thickness_mm; }

 private:
  // Value, first and second derivative of r and y.
  struct Knot {
    Eigen::Array2d value, slope, bend;
  };

  TyreSection options_;
  std::vector<Knot> knots_;  // at s = 0, 1, 2... mm
};

template <typename T>
Meridian::Point<T> Meridian::At(const T& s) const {
  const bool negative = s < 0.0;
  const T a = negative ? T(-s) : s;
  // The last piece goes on beyond the bead.
  const auto last = static_cast<int>(knots_.size()) - 2;
  const int k = std::min(static_cast<int>(ValueOf(a)), last);
  const Knot& p = knots_[static_cast<std::size_t>(k)];
  const Knot& q = knots_[static_cast<std::size_t>(k) + 1];
  const double t = ValueOf(a) - k;
  T out[2];
  for (int c = 0; c < 2; ++c) {
    // Quintic Hermite on a unit interval, in powers of t.
    const double d = q.value[c] - p.value[c];
    const double c3 = 10 * d - 6 * p.slope[c] - 4 * q.slope[c] - 1.5 * p.bend[c] + 0.5 * q.bend[c];
    const double c4 = -15 * d + 8 * p.slope[c] + 7 * q.slope[c] + 1.5 * p.bend[c] - q.bend[c];
    const double c5 = 6 * d - 3 * p.slope[c] - 3 * q.slope[c] - 0.5 * p.bend[c] + 0.5 * q.bend[c];
    out[c] = Chain(
        a, p.value[c] + t * (p.slope[c] + t * (0.5 * p.bend[c] + t * (c3 + t * (c4 + t * c5)))),
        p.slope[c] + t * (p.bend[c] + t * (3 * c3 + t * (4 * c4 + t * 5 * c5))));
  }
  return {out[0], negative ? T(-out[1]) : out[1]};
}

}  // namespace plumbline::internal
