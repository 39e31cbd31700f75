#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "calib/optimization_inputs.h"

namespace plumbline {

// How sure a calibration is about where a point is seen, and about what is triangulated, when the
// observations of the board carry independent noise.
//
// With J the packed Jacobian of the solve and D its scaling, noise of standard deviation s moves
// the optimum by db with  Var(dF/db db) = s^2 (J_obs A)'(J_obs A),  A = (J'J)^-1 (dF/db D)', where
// J_obs leaves the regularization rows out; without such rows it is s^2 (dF/db D) A.
//
// A change of the intrinsics alone does not say where a point fixed in the world will be seen: the
// camera moves with them. The two ways here differ in how they find that motion.
//
//   Mean-pcam (mrcal 2.2): the point is carried by every board pose; the mean of where they take it
//   is
//     projected. Reads up to twice too high.
//   Cross-reprojection (mrcal from 2026 on): the camera's motion is the one that makes the new
//     geometry, seen through the old intrinsics, fit this camera's observations best:
//       Jx = d x / d rt_cc+ (its own rows),  K = -(Jx'Jx)^-1 Jx' J_{everything but intrinsics},
//       dq/db = dq/di + dq/dp [skew(p) | -I] K.
//     Monte-Carlo re-solves agree with it (docs/projection_uncertainty.md).
//
// Triangulated points are stabilised by the same motion, of the left camera: dp/db + [-skew(p) | I]
// K. Without it the drift of the rig frame, which no measurement shows, would be counted.
//
// Source: mrcal, "Projection uncertainty", http://mrcal.secretsauce.net/uncertainty.html
// Units:  px, mm (the inputs themselves are in metres). Independent noise only: what the target's
//         shape and the correlation within photographs add is in CalibrationModes.
// Accuracy: tests/calib/projection_uncertainty_test.cc.
class ProjectionUncertainty {
 public:
  struct Options {
    // Standard deviation of one coordinate of an observation of weight 1. Left out: the rms of the
    // inlier residuals divided by sqrt(1 - unknowns / observed coordinates).
    std::optional<double> noise_px;
  };

  // The inputs must be at their optimum. Throws InputError if they are not consistent, or do not
  // determine the unknowns.
  ProjectionUncertainty(const OptimizationInputs& inputs, const Options& options);
  explicit ProjectionUncertainty(const OptimizationInputs& inputs)
      : ProjectionUncertainty(inputs, Options()) {}

  double noise_px() const;

  // Covariance (px^2) of the pixel at which camera `camera` of the inputs sees a point (mm, in that
  // camera's frame). At infinity only the direction counts, and translations are ignored.
  //
  // Throws InputError for a camera that is not there or moves, a point that it cannot see, or
  // (CrossReprojection) a solve that held both the boards and this camera's pose fixed.
  Eigen::Matrix2d MeanPcam(int camera, const Eigen::Vector3d& point_in_camera_mm,
                           bool at_infinity = false) const;
  Eigen::Matrix2d CrossReprojection(int camera, const Eigen::Vector3d& point_in_camera_mm,
                                    bool at_infinity = false) const;

  // Covariance (mm^2, left camera's frame) of a point triangulated from the two pixels at which the
  // cameras see it, these taken as exact; stabilised.
  Eigen::Matrix3d TriangulatedPoint(int left, int right,
                                    const Eigen::Vector3d& point_in_left_mm) const;

  // Variance (mm^2) of the distance between two points so triangulated. Their common errors cancel;
  // no stabilisation takes part.
  double LengthVariance(int left, int right, const Eigen::Vector3d& a_in_left_mm,
                        const Eigen::Vector3d& b_in_left_mm) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace plumbline
