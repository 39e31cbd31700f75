#pragma once

#include <ceres/jet.h>

#include <Eigen/Core>
#include <memory>
#include <utility>

#include "io/virtual_rig/material_surface.h"

namespace plumbline::internal {

template <typename T>
using Vector3 = Eigen::Matrix<T, 3, 1>;

// A SurfaceInstant of a shape that is written once, for any scalar, and differentiated exactly by
// dual numbers. A Shape has
//
//   template <typename S> State<S> StateAt(const S& time_s) const;
//     what depends on time only, with its time derivative where S is a jet
//   template <typename T, typename S>
//   Vector3<T> Position(const State<S>& state, const T& u, const T& v) const;
//   MaterialDomain WindowAt(const State<double>& state) const;
//
// and outlives the instant.
template <typename Shape>
class JetInstant : public SurfaceInstant {
 public:
  JetInstant(std::shared_ptr<const Shape> shape, double time_s)
      : shape_(std::move(shape)),
        state_(shape_->StateAt(time_s)),
        moving_state_(shape_->StateAt(TimeJet(time_s, 0))) {}

  SurfacePoint At(const Eigen::Vector2d& m) const override {
    using J = ceres::Jet<double, 2>;
    const Vector3<J> p = shape_->Position(state_, J(m.x(), 0), J(m.y(), 1));
    SurfacePoint point;
    for (int k = 0; k < 3; ++k) {
      point.position_mm[k] = p[k].a;
      point.d_position_d_material.row(k) = p[k].v.transpose();
    }
    return point;
  }

  Eigen::Vector3d Velocity(const Eigen::Vector2d& m) const override {
    const Vector3<TimeJet> p = shape_->Position(moving_state_, TimeJet(m.x()), TimeJet(m.y()));
    return {p[0].v[0], p[1].v[0], p[2].v[0]};
  }

  MaterialDomain Window() const override { return shape_->WindowAt(state_); }

 private:
  using TimeJet = ceres::Jet<double, 1>;
  template <typename S>
  using State = decltype(std::declval<const Shape&>().StateAt(std::declval<S>()));

  std::shared_ptr<const Shape> shape_;
  State<double> state_;
  State<TimeJet> moving_state_;
};

}  // namespace plumbline::internal
