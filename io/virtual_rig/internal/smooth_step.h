#pragma once

#include <ceres/jet.h>

namespace plumbline::internal {

// The plain number in a scalar or a dual number.
inline double ValueOf(double x) { return x; }
template <int N>
double ValueOf(const ceres::Jet<double, N>& x) {
  return x.a;
}

// f(x) with its derivative, of a function of one variable whose value and slope at ValueOf(x) are
// known: cheaper than letting dual numbers walk through the formula.
inline double Chain(double, double value, double) { return value; }
template <int N>
ceres::Jet<double, N> Chain(const ceres::Jet<double, N>& x, double value, double slope) {
  return ceres::Jet<double, N>(value, slope * x.v);
}

// 0 below 0, 1 above 1, between them x^3 (10 - 15 x + 6 x^2): two continuous derivatives.
template <typename T>
T SmoothStep(const T& argument) {
  const double x = ValueOf(argument);
  if (x <= 0) return T(0.0);
  if (x >= 1) return T(1.0);
  return Chain(argument, x * x * x * (10 - x * (15 - 6 * x)), 30 * x * x * (1 - x) * (1 - x));
}

// The ramp max(a, 0) with its corner rounded over -w < a < w: exactly 0 below, exactly a above,
// never smaller than either; its slope is SmoothStep, so that it has three continuous derivatives.
template <typename T>
T SmoothRamp(const T& a, double w) {
  const double value = ValueOf(a);
  if (value <= -w) return T(0.0);
  if (value >= w) return a;
  const double x = (value + w) / (2 * w);
  return Chain(a, 2 * w * (x * x * x * x * (2.5 - x * (3 - x))), SmoothStep(x));
}

}  // namespace plumbline::internal
