#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>

#include "calib/stereo_rig.h"
#include "calib/triangulate.h"

namespace plumbline {

// Has the right camera moved against the left one since they were calibrated?
//
// Every speckle match says how far the right pixel lies from the epipolar line of the left one.
// From some hundred matches over the image follows the pose of the right camera but for the length
// of its baseline (five degrees of freedom), which the calibration or a known distance gives.
//
// Minimised over right_from_left = (R, t) is the sum of squares of
//   z = a / sqrt(g' S g),   a = r1 . (t x R r0),   g = d a / d (left pixel, right pixel),
// with r0, r1 the viewing rays in their own cameras and S = cov_px2: the first-order distance of
// the four pixel coordinates from the epipolar constraint in their own metric (Sampson's distance;
// Hartley and Zisserman, Multiple View Geometry, 2nd ed., 11.4.3 and 4.2.6). It is what remains of
// bundle adjustment with cameras held and every point free when each is eliminated: the pose is
// that of AdjustBundle() to 1e-2 sigma and its covariance to 1e-3, some eight times faster.
// Gauss-Newton on the essential manifold, (R, t) <- exp(dw, B db) (R, t) with B (3x2) across t,
// exact derivatives.
//
// Mismatches: Cauchy weights lead to the solution, their scale falling with the scatter of the
// residuals; then plain least squares over the matches within outlier_sigmas. A mismatch along its
// epipolar line is not seen, and does no harm.
//
// Frames: right, left (the rig); mm, rad, px.

struct DistanceBetweenObservations {
  std::size_t a = 0, b = 0;  // indices into the observations
  double distance_mm = 0;
  double sigma_mm = 0.01;
};

struct RelativePoseOptions {
  // Sets the length of the baseline; without it, it is the rig's.
  std::optional<DistanceBetweenObservations> known_distance;
  // More observations than this are thinned evenly: every n-th.
  int max_points = 6000;
  // So many of the observations share one noise, as those of subsets that overlap do
  // (CorrelationArea()); less where they are thinned. cov_random counts it.
  double alike_points = 1;
  // Beyond so many sigmas from its epipolar line a match is a mismatch. The sigmas are the given
  // ones, or what the median residual says where that is more.
  double outlier_sigmas = 4.5;
  // Where the matches scatter by more than they claim, so does the pose: cov_random is multiplied
  // by sigma0^2 if that is above 1, in chi2 too.
  bool scale_by_scatter = false;
  // Another right_from_left that the epipolar distances of the points are told with.
  std::optional<Rigid3> other_pose;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Covariances have the order (rotation vector rad, translation mm).
struct RelativePose {
  Rigid3 right_from_left;  // refined
  // The refined pose is  Rigid3::FromRotationVector(change.head<3>(), change.tail<3>()) *
  // rig.right_from_left: the motion of the right camera, in its own frame.
  Eigen::Matrix<double, 6, 1> change = Eigen::Matrix<double, 6, 1>::Zero();
  // Of `change`, from the noise of the matches alone, as given by their covariances (see
  // scale_by_scatter). Of rank 5 without a known distance: nothing along t.
  Eigen::Matrix<double, 6, 6> cov_random = Eigen::Matrix<double, 6, 6>::Zero();
  // Of `change`, from the calibration: how a camera that did not move seems to have moved because
  // the rig is not quite as calibrated. The refinement re-evaluated once a mode, to first order in
  // the residuals, each from the mode's own pose. Zero when the rig carries no modes.
  Eigen::Matrix<double, 6, 6> cov_calibration = Eigen::Matrix<double, 6, 6>::Zero();
  // Root mean square distance from the epipolar line, px of the right image, of the points used;
  // with the rig's pose, with the refined one and with options.other_pose (NaN without it).
  double epipolar_rms_before_px = 0;
  double epipolar_rms_after_px = 0;
  double epipolar_rms_other_px = 0;
  double epipolar_mean_before_px = 0;  // signed (TriangulatedPoint::epipolar_px)
  double epipolar_sigma_px = 0;        // the rms that the given covariances let expect
  double sigma0 = 0;   // sqrt(sum z^2 / (points - 5)): 1 where the given covariances are right
  int points = 0;      // used
  int mismatches = 0;  // left out, of those looked at
  // change' (cov_random + cov_calibration)^-1 change over the directions that are observable: all
  // six with a known distance, else the five without the length of the baseline. Chi-squared of so
  // many degrees of freedom where nothing has moved.
  double chi2 = 0;
  int degrees_of_freedom = 5;
};

// Refines the pose of the right camera against the left one from matches.
//
// The matches must be spread over the image. Of a dense grid, whose subsets overlap, pass all, with
// RelativePoseOptions::alike_points: some that lie apart tell the pose less well, for neighbours
// have noise of their own too. A flat surface will do, but some directions are then weak;
// cov_random says which. Observations whose pixels are not finite or have no ray are left out.
//
// Throws InputError when the points do not determine the pose (fewer than 12 that share no noise,
//        along a line, in one corner ...): when the least certain direction is so uncertain that
//        noise in the derivatives passes for information, 1 / sigma^2 < 100 points (rad);
//        UsageError from the options; std::invalid_argument for a known distance between
//        observations that are not there or cannot be triangulated, and for a covariance that gives
//        no positive variance across the epipolar line.
//
// The same bits for any number of threads.
// Accuracy: tests/calib/relative_pose_test.cc.
[[nodiscard]] RelativePose RefineRelativePose(const StereoRig& rig,
                                              std::span<const StereoObservation> observations,
                                              const RelativePoseOptions& options = {});

// The motion of the right camera between two instants.
struct PoseChange {
  // later.right_from_left = FromRotationVector(change) * earlier.right_from_left
  Eigen::Matrix<double, 6, 1> change;
  Eigen::Matrix<double, 6, 6> cov_random;  // of change
  double chi2 = 0;                         // against cov_random, over the observable directions
  int degrees_of_freedom = 5;
};

// What has changed from one instant to another, both refined from the same rig: what calibration
// and lenses get wrong is common to both and cancels, as far as the points see the same parts of
// the images. The two must come from different matches (noise that they share would cancel too).
// Six degrees of freedom where either has a known distance.
[[nodiscard]] PoseChange Between(const RelativePose& earlier, const RelativePose& later);

}  // namespace plumbline
