#include "io/virtual_rig/internal/meridian.h"

namespace plumbline::internal {
namespace {

// Curvature of the section at arc length s (1/mm).
double Curvature(const TyreSection& o, double s) {
  const auto blend = [&](double begin) { return SmoothStep((s - begin) / o.blend_mm); };
  return o.crown_curvature +
         (o.shoulder_curvature - o.crown_curvature) * blend(o.shoulder_begin_mm) +
         (o.sidewall_curvature - o.shoulder_curvature) * blend(o.sidewall_begin_mm);
}

}  // namespace

Meridian::Meridian(const TyreSection& options) : options_(options) {
  constexpr int kSteps = 64;  // a millimetre: Simpson's rule is then exact to 1e-12 mm
  const int count = static_cast<int>(std::ceil(options.half_length_mm)) + 1;
  double tau = 0;  // angle of the tangent against the axis
  Eigen::Array2d value(options.crown_radius_mm, 0);
  for (int k = 0; k <= count; ++k) {
    const double kappa = Curvature(options, k);
    const Eigen::Array2d tangent(-std::sin(tau), std::cos(tau));
    const Eigen::Array2d normal(-std::cos(tau), -std::sin(tau));
    knots_.push_back({value, tangent, kappa * normal});
    constexpr double h = 1.0 / kSteps;
    for (int i = 0; i < kSteps; ++i) {
      const double s = k + i * h;
      const double turn =
          h / 6 *
          (Curvature(options, s) + 4 * Curvature(options, s + h / 2) + Curvature(options, s + h));
      const double half = h / 12 *
                          (Curvature(options, s) + 4 * Curvature(options, s + h / 4) +
                           Curvature(options, s + h / 2));
      const auto along = [](double t) { return Eigen::Array2d(-std::sin(t), std::cos(t)); };
      value += h / 6 * (along(tau) + 4 * along(tau + half) + along(tau + turn));
      tau += turn;
    }
  }
}

}  // namespace plumbline::internal
