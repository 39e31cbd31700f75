#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace plumbline::internal {

// The viewing rays of one match, each in its own camera.
struct MatchRays {
  Eigen::Vector3d r0, r1;              // left, right; of unit length
  Eigen::Matrix<double, 3, 2> F0, F1;  // d ray / d pixel (1 / px)
  Eigen::Matrix4d cov_px2;             // (left x, left y, right x, right y)
};

// How far a match is from the epipolar constraint of a pose; see relative_pose.h.
//
// Derivatives are with respect to (dw, db) of R <- exp(dw) R, t <- exp(dw) t + B db, B (3x2).
struct EpipolarResidual {
  using Row = Eigen::Matrix<double, 1, 5>;

  double z = 0;            // a / sigma: in units of its own sigma
  double sigma = 0;        // of a; NaN where its square is not positive
  double distance_px = 0;  // of the right pixel from the epipolar line
  double sigma_px = 0;     // of that distance
  Row d_z = Row::Zero();
  Row d_a = Row::Zero();  // over sigma: what d_z is without the change of sigma
};

// a = r1 . (t x R r0), which the pose makes zero, with d a / d (left x, left y, right x, right y).
struct EpipolarConstraint {
  double a = 0;
  Eigen::Vector4d d_pixels;

  EpipolarConstraint(const Eigen::Vector3d& r0, const Eigen::Matrix<double, 3, 2>& F0,
                     const Eigen::Vector3d& r1, const Eigen::Matrix<double, 3, 2>& F1,
                     const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
    const Eigen::Vector3d plane = t.cross(R * r0);  // its normal, in the right camera
    a = plane.dot(r1);
    d_pixels << (R * F0).transpose() * r1.cross(t), F1.transpose() * plane;
  }

  // How much `a` changes a pixel of the right image, across the epipolar line.
  double per_px() const { return d_pixels.tail<2>().norm(); }
};

EpipolarResidual EvaluateEpipolar(const MatchRays& match, const Eigen::Matrix3d& R,
                                  const Eigen::Vector3d& t, const Eigen::Matrix<double, 3, 2>& B);

}  // namespace plumbline::internal
