#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "calib/camera.h"
#include "calib/rigid3.h"

namespace plumbline {

// Bundle adjustment: cameras, rigid motions and points that explain pixels best, and how sure each
// is.
//
// An observation says that a camera saw a point at a pixel. The point is moved into the camera by a
// chain of up to two motions, any of which may be shared with other observations:
//   pixel = project(cameras[c], camera_from_rig * rig_from_frame * point) + noise, cov_px2.
// A moving stereo rig has one camera_from_rig a camera and one rig_from_frame a frame; a
// calibration board one rig_from_frame a photograph, its points fixed or free. -1 stands for the
// identity.
//
// Minimised is  sum_i rho(|L_i^-1 (projected_i - pixel_i)|^2) + sum_d ((|a - b| - distance) /
// sigma)^2, with cov_px2 = L L' and rho the robust loss (not applied to known distances).
//
// Gauge. Pixels do not see where the common frame is, nor how large the scene. What is held fixed,
// and known distances, decide; where they do not, BundleGauge says what happens.
//
// Frames: target_from_source. Units: mm, rad, px. A motion's tangent order is (rotation vector rad,
// translation mm), that of Rigid3::FromRotationVector, whose parameters they are.
//
// Example:
//   BundleProblem problem;
//   problem.cameras = {{left, /*fixed=*/true}, {right, true}};
//   problem.motions = {{right_from_left, true}, {first_pose, true}, {second_pose}};
//   problem.points = {{a}, {b}, ...};
//   problem.observations = {{.camera = 1, .camera_from_rig = 0, .rig_from_frame = 2, .point = 7,
//   ...}}; BundleResult result = AdjustBundle(problem); Eigen::MatrixXd cov =
//   result.Covariance(std::vector{BundleBlock::Motion(2)});
struct BundleCamera {
  Camera camera;
  bool fixed = false;
};
struct BundleMotion {
  Rigid3 motion;
  bool fixed = false;
};
struct BundlePoint {
  Eigen::Vector3d point_mm;
  bool fixed = false;
};

struct BundleObservation {
  int camera = 0;
  int camera_from_rig = -1;  // index into motions, or -1: identity
  int rig_from_frame = -1;
  int point = 0;
  Eigen::Vector2d pixel;  // raw
  Eigen::Matrix2d cov_px2 = Eigen::Matrix2d::Identity();
};

// A distance between two points that somebody measured: it sets the scale.
struct KnownDistance {
  int point_a = 0;
  int point_b = 0;
  double distance_mm = 0;
  double sigma_mm = 0.01;
};

struct BundleProblem {
  std::vector<BundleCamera> cameras;
  std::vector<BundleMotion> motions;
  std::vector<BundlePoint> points;
  std::vector<BundleObservation> observations;
  std::vector<KnownDistance> distances;
};

enum class BundleLoss { kSquared, kHuber, kCauchy };

enum class BundleGauge {
  // What is fixed and known must determine everything; refused otherwise, naming what is free.
  kAsGiven,
  // Directions in which motions and points can move together without any pixel changing are held by
  // as many prior rows as there are such directions, on the motions (in units of their own
  // information), at the starting values. The residuals do not change; covariances are those in
  // this
  // gauge. Only for directions without intrinsics: an undetermined lens is refused.
  kMinimalPrior
};

struct BundleOptions {
  BundleLoss loss = BundleLoss::kSquared;
  double loss_scale_sigmas = 2.0;  // where the loss departs from the square
  BundleGauge gauge = BundleGauge::kAsGiven;
  int max_iterations = 100;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What a covariance is asked of: all parameters of a camera, a motion (6) or a point (3).
struct BundleBlock {
  enum class Kind { kCamera, kMotion, kPoint };
  Kind kind;
  int index;

  static BundleBlock Camera(int index) { return {Kind::kCamera, index}; }
  static BundleBlock Motion(int index) { return {Kind::kMotion, index}; }
  static BundleBlock Point(int index) { return {Kind::kPoint, index}; }
};

struct BundleResult {
  // The problem with its free parts replaced; fixed ones are the same bits.
  BundleProblem solved;
  std::vector<Eigen::Vector2d> residuals_px;  // projected less observed, per observation
  std::vector<double> weights;  // 1, less where the loss took an observation for an outlier
  bool converged = false;
  int iterations = 0;
  int degrees_of_freedom = 0;  // residual scalars less free parameters (plus gauge directions)
  int gauge_directions = 0;    // held by kMinimalPrior
  // sqrt(weighted sum of squares / degrees of freedom): 1 where the given covariances are right.
  double sigma0 = 0;

  // Joint covariance of the chosen blocks, in their order; fixed blocks are zero. First order, with
  // the robust weights; `scaled` multiplies by sigma0^2. By the analytic Schur complement over the
  // points: with H_p the information of a point, W its coupling to cameras and motions,
  //   Cov_c = (H_c - sum W H_p^-1 W')^-1,  Cov_p = H_p^-1 + H_p^-1 W' Cov_c W H_p^-1.
  // Cost: the cube of the free camera and motion parameters once, in AdjustBundle.
  // Throws std::out_of_range for a block that is not there.
  Eigen::MatrixXd Covariance(std::span<const BundleBlock> blocks, bool scaled = false) const;

  struct Information;
  std::shared_ptr<const Information> information;
};

// Solves with Ceres (Levenberg-Marquardt, Schur complement, one thread: the same bits everywhere),
// exact derivatives.
//
// Throws InputError when the problem is under-determined, naming what is not constrained, or when
// an
//        observed point is not in front of its camera at the start; std::invalid_argument for
//        indices out of range, covariances that are not positive definite, and numbers that are not
//        finite.
[[nodiscard]] BundleResult AdjustBundle(const BundleProblem& problem,
                                        const BundleOptions& options = {});

}  // namespace plumbline
