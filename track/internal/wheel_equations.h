#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "track/wheel_adjustment.h"

namespace plumbline::internal {

// One observation at the current values, all in its sigmas.
struct WheelRow {
  Eigen::Vector2d residual;            // projected less observed
  Eigen::Matrix<double, 2, 4> d_axis;  // order of WheelAdjustment
  Eigen::Vector2d d_angle;
  Eigen::Matrix<double, 2, 3> d_point;
};

// The observations of a wheel and their normal equations, reduced to axis and angles ("core"; order
// of WheelAdjustment). Points are eliminated:
//   H = H_c - sum W_p' H_p^-1 W_p,   g = g_c - sum W_p' H_p^-1 g_p.
// Sums are taken in an order that does not depend on the number of threads.
class WheelEquations {
 public:
  // Keeps references. Throws std::invalid_argument as AdjustWheel().
  WheelEquations(const StereoRig& rig, const WheelProblem& problem);

  Eigen::Index core_size() const { return core_size_; }
  // In the order of the problem, as all that is given an observation each.
  std::size_t size() const { return whiten_.size(); }

  // Evaluates all observations at these values. False where one is not in front of its camera.
  bool Evaluate(const WheelAxis& axis, std::span<const double> angles_rad,
                std::span<const Eigen::Vector3d> points_mm);
  const WheelRow& row(std::size_t i) const { return rows_[i]; }
  // The change of projection i, in its sigmas, for another rig.
  std::vector<Eigen::Vector2d> ChangeFor(const StereoRig& rig) const;
  // The same when the wheel turns on by so much more in each frame until the right camera exposes.
  std::vector<Eigen::Vector2d> ChangeForLater(std::span<const double> by_rad) const;

  // The reduced matrix of the values evaluated last, with these weights (0: left out). Points and
  // frames that are not determined are left out with their observations. Throws InputError where
  // the rest does not determine axis and angles.
  void Reduce(std::span<const double> weights);
  bool PointDetermined(std::size_t p) const { return points_[p].determined; }
  bool FrameDetermined(std::size_t f) const { return frame_determined_[f]; }
  // Observations that count, and unknowns.
  int rows() const { return 2 * counted_; }
  int unknowns() const { return unknowns_; }

  // The step that takes these residuals to their least squares.
  struct Step {
    Eigen::VectorXd core;
    std::vector<Eigen::Vector3d> points;
    double decrement = 0;  // what the sum of squares falls by if all is linear
  };
  Step Solve(const std::function<const Eigen::Vector2d&(std::size_t)>& residual) const;

  Eigen::MatrixXd CoreCovariance() const;  // rows of what is not determined are zero
  const WheelAdjustment::PointError& ErrorOf(std::size_t p) const { return points_[p]; }
  Eigen::Matrix3d PointCovariance(std::size_t p, const Eigen::MatrixXd& cov_core) const;

 private:
  struct Eliminated : WheelAdjustment::PointError {  // own: H_p^-1; transfer: H_p^-1 W_p
    bool determined = false;
  };

  void Project(const StereoRig& rig, std::span<Eigen::Vector2d> pixels,
               std::vector<Eigen::Matrix<double, 2, 3>>* d_pixel_d_rig) const;
  void Eliminate(std::size_t p, Eigen::MatrixXd& core);
  void Factor();
  template <typename Body>
  void OverChunks(const Body& body) const;

  const StereoRig& rig_;
  const WheelProblem& problem_;
  Eigen::Index core_size_ = 0;
  std::vector<Eigen::Matrix2d> whiten_;
  std::vector<std::vector<std::size_t>> seen_;  // a point each: its observations
  std::vector<Eigen::Vector3d> in_rig_mm_;      // the point of each when it is seen, evaluated last
  std::vector<WheelRow> rows_;
  std::vector<double> weights_;
  std::vector<Eliminated> points_;
  std::vector<bool> frame_determined_;
  std::vector<Eigen::Index> held_;  // entries of the core that are not unknown
  int counted_ = 0, unknowns_ = 0;
  Eigen::MatrixXd core_;
  Eigen::VectorXd scale_;
  Eigen::LLT<Eigen::MatrixXd> factor_;
};

}  // namespace plumbline::internal
