#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace plumbline::internal {

struct SearchSteps {
  int coarse = 24;  // places tried
  int golden = 18;  // steps of the golden section
};

// The largest value of f over [low, high]: the best of evenly spaced places, refined by golden
// section between its neighbours.
template <typename F>
double Maximise(double low, double high, const SearchSteps& steps, const F& f) {
  double best = low, value = -std::numeric_limits<double>::infinity();
  const double step = (high - low) / steps.coarse;
  for (int k = 0; k <= steps.coarse; ++k) {
    const double v = f(low + k * step);
    if (v > value) {
      value = v;
      best = low + k * step;
    }
  }
  double a = std::max(low, best - step), b = std::min(high, best + step);
  const double ratio = (std::sqrt(5.0) - 1) / 2;
  double c = b - ratio * (b - a), d = a + ratio * (b - a), fc = f(c), fd = f(d);
  for (int k = 0; k < steps.golden; ++k) {
    if (fc > fd) {
      b = std::exchange(d, c);
      fd = fc;
      c = b - ratio * (b - a);
      fc = f(c);
    } else {
      a = std::exchange(c, d);
      fc = fd;
      d = a + ratio * (b - a);
      fd = f(d);
    }
  }
  return fc > value || fd > value ? (fc > fd ? c : d) : best;
}

}  // namespace plumbline::internal
