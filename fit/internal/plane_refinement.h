#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>

namespace plumbline::internal {

// A plane with the basis in which its small changes are counted: a turn (a, b) takes the normal to
// exp([a e1 + b e2]x) normal, a shift moves the plane along the normal at the centroid.
struct LocalPlane {
  Eigen::Vector3d normal, e1, e2, centroid;

  Eigen::Matrix3d RotationFromTurn(double a, double b) const;
  Eigen::Vector3d NormalTurned(double a, double b) const;
  // The plane after the step (a, b in rad, shift in mm); the basis turns along.
  LocalPlane Moved(const Eigen::Vector3d& step) const;
};

// A right-handed basis (e1, e2, normal); e1 is as near as it can be to the x axis.
LocalPlane MakeLocalPlane(const Eigen::Vector3d& normal, const Eigen::Vector3d& centroid);

// The distance of a point from the plane over its sigma along the normal, sqrt(n' C n), and the
// derivative with respect to the step of LocalPlane::Moved.
struct PlaneResidual {
  double distance_mm = 0;
  double sigma_mm = 0;
  double whitened = 0;
  Eigen::Vector3d d_whitened_d_step = Eigen::Vector3d::Zero();
};
PlaneResidual EvaluatePlaneResidual(const LocalPlane& plane, const Eigen::Vector3d& point_mm,
                                    const Eigen::Matrix3d& cov_mm2, double sigma_floor_mm);

// First and second moments of the points whose mask is set.
struct Moments {
  std::size_t count = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();  // of the points' places
};
Moments PointMoments(std::span<const Eigen::Vector3d> points_mm, std::span<const std::uint8_t> use);

struct PlaneSolution {
  LocalPlane plane;
  Eigen::Matrix3d inverse_normal_matrix;  // of the whitened residuals
  double scatter_ratio = 0;
  double rms_mm = 0;
};
// Gauss-Newton with Huber weights from a start near the answer; see ground_plane.h.
PlaneSolution RefinePlane(std::span<const Eigen::Vector3d> points_mm,
                          std::span<const Eigen::Matrix3d> cov_mm2,
                          std::span<const std::uint8_t> use, const LocalPlane& start);

}  // namespace plumbline::internal
