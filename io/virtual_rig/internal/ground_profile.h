#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

#include "io/virtual_rig/internal/smooth_step.h"
#include "io/virtual_rig/tyre_surface.h"

namespace plumbline::internal {

// The ground and what a tyre makes of it.
//
// A tyre cannot follow an edge: a carcass of bending length l rises to an obstacle of height h over
// a distance of 2 sqrt(h l). Enveloped() is that smooth shape: never below the ground, equal to it
// on top of a bar or nut and on the flat ground, twice continuously differentiable.
class GroundProfile {
 public:
  // Throws UsageError when obstacles are so near to each other that their envelopes overlap.
  explicit GroundProfile(std::vector<Obstacle> obstacles = {}, double bending_length_mm = 30);

  double Height(const Eigen::Vector2d& ground_mm) const;

  // For double and for dual numbers.
  template <typename T>
  T Enveloped(const T& X, const T& Y) const;

  // How far the carcass's material is gathered towards obstacles (mm): a carcass is nearly
  // inextensible, so what climbs a flank is drawn in from beside it. Fixed to the ground, so that
  // material which sticks to the ground stays where it is. At the place (X, Y) where the material
  // would be without obstacles.
  template <typename T>
  Eigen::Matrix<T, 2, 1> Gathered(const T& X, const T& Y) const;

  // Signed distance into the zone in which the envelope bridges (mm): positive where Enveloped() is
  // above Height() because the tyre hangs between an obstacle's top and the flat ground.
  double Bridging(const Eigen::Vector2d& ground_mm) const;

  const std::vector<Obstacle>& obstacles() const { return obstacles_; }

 private:
  struct Bump {
    Eigen::Vector2d centre;
    Eigen::Vector2d across;  // unit; zero for a nut, which is round
    double plateau;          // half width (radius) over which the envelope is at the top
    double flank;            // width of the rise
    double height;
    double gathered;  // in all, by one flank
  };

  std::vector<Obstacle> obstacles_;
  std::vector<Bump> bumps_;
};

template <typename T>
Eigen::Matrix<T, 2, 1> GroundProfile::Gathered(const T& X, const T& Y) const {
  using std::sqrt;
  Eigen::Matrix<T, 2, 1> way(T(0.0), T(0.0));
  for (const Bump& bump : bumps_) {
    Eigen::Matrix<T, 2, 1> from(X - bump.centre.x(), Y - bump.centre.y());
    if (!bump.across.isZero()) {
      const T along = from.x() * bump.across.x() + from.y() * bump.across.y();
      from = {T(along * bump.across.x()), T(along * bump.across.y())};
    }
    const T distance2 = from.x() * from.x() + from.y() * from.y();
    if (distance2 <= bump.plateau * bump.plateau) continue;
    const T distance = sqrt(distance2);
    // The square of the envelope's slope, integrated: the normalised integral of x^4 (1 - x)^4.
    const T x = (distance - bump.plateau) / (bump.flank + bump.gathered);
    const double t = ValueOf(x);
    T share(1.0);
    if (t < 1) {
      share = Chain(x, t * t * t * t * t * (126 - t * (420 - t * (540 - t * (315 - t * 70)))),
                    630 * t * t * t * t * (1 - t) * (1 - t) * (1 - t) * (1 - t));
    }
    way -= from * T(bump.gathered * share / distance);
  }
  return way;
}

template <typename T>
T GroundProfile::Enveloped(const T& X, const T& Y) const {
  using std::abs;
  using std::sqrt;
  T height(0.0);
  for (const Bump& bump : bumps_) {
    const T dx = X - bump.centre.x(), dy = Y - bump.centre.y();
    const bool round = bump.across.isZero();
    const T along = dx * bump.across.x() + dy * bump.across.y();
    const T distance2 = round ? T(dx * dx + dy * dy) : T(along * along);
    const double end = bump.plateau + bump.flank;
    if (distance2 >= end * end) continue;
    if (distance2 <= bump.plateau * bump.plateau) {
      height += bump.height;
      continue;
    }
    height += bump.height * SmoothStep(T((end - sqrt(distance2)) / bump.flank));
  }
  return height;
}

}  // namespace plumbline::internal
