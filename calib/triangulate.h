#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "calib/status.h"
#include "calib/stereo_rig.h"

namespace plumbline {

// From a pixel in each image to a point in space, and how sure.
//
// Frames:  `rig` is the left camera; x right, y down, z forward.
// Pixels:  (0, 0) is the centre of the top-left pixel; raw, not undistorted.
// Units:   mm, rad, px; sigmas are one standard deviation.
//
// The point is the midpoint of the common perpendicular of the two viewing rays (Lee and Civera,
// "Triangulation: Why Optimize?", BMVC 2019, section 3; mrcal calls it triangulate_geometric). With
// unit rays f0 (left) and f1 (right, turned into the rig frame) and the right camera's centre c,
//   n = f0 x f1,  depth0 = (c x f1) . n / n.n,  depth1 = (c x f0) . n / n.n,
//   point = (depth0 f0 + c + depth1 f1) / 2.
// On a calibrated DIC rig, whose rays miss each other by a fraction of a pixel, it differs from the
// maximum-likelihood point in the second order of that miss.

// One surface point seen by both cameras.
struct StereoObservation {
  Eigen::Vector2d left;   // px, raw image
  Eigen::Vector2d right;  // px, raw image
  Eigen::Matrix4d cov_px2 =
      Eigen::Matrix4d::Identity();  // order (left x, left y, right x, right y)
};

struct TriangulatedPoint {
  Eigen::Vector3d point_in_rig;  // mm
  Eigen::Matrix3d cov_mm2;       // from the observation's covariance alone
  // d point_in_rig / d (left x, left y, right x, right y), mm / px.
  Eigen::Matrix<double, 3, 4> d_point_d_pixels;
  // Signed distance of the right pixel from the epipolar line of the left one, in px of the right
  // image: positive where the right pixel lies on the lower side of it, for a right camera that
  // sits to the right. The line is the straight one that the epipolar plane draws on the right
  // image through the lens linearised at the right pixel: with the plane's normal m = t x R f0 in
  // the right camera (R, t = right_from_left), its ray r and F = d r / d pixel,  epipolar = m.r /
  // |F' m|.
  double epipolar_px = 0;
  double sigma_epipolar_px = 0;  // first order at epipolar_px = 0
  Status status = Status::kOk;
};

// Triangulates one stereo correspondence and propagates its covariance.
//
// The covariance is first order, J S J', S = observation.cov_px2, J (3x4) exact. Calibration
// uncertainty is not in it: see CalibrationModes.
//
// Returns: status == kOk, or the reason, with NaN in point and covariance:
//            kOutsideImage  a pixel is not finite, or the lens model has no ray there;
//            kBehindCamera  the rays meet behind a camera, or are parallel (within 1e-9 rad).
//          epipolar_px and its sigma are given wherever both pixels have a ray, else NaN.
// Throws:  std::invalid_argument if the covariance of an observation with finite pixels is not
//          finite and symmetric.
//
// Pure and thread-safe; does not allocate.
// Accuracy: tests/calib/triangulate_test.cc (NEES over 2000 noisy draws).
[[nodiscard]] TriangulatedPoint Triangulate(const StereoRig& rig,
                                            const StereoObservation& observation);

// Many at once, in parallel: the same bits as one by one, for any number of threads. Throws before
// it starts, naming the first observation whose covariance is not finite and symmetric.
[[nodiscard]] std::vector<TriangulatedPoint> Triangulate(
    const StereoRig& rig, std::span<const StereoObservation> observations);

// The points alone (mm, rig frame), for re-evaluation along calibration modes: NaN where
// Triangulate() reports a status. Parallel, the same bits for any number of threads. Throws
// std::invalid_argument when the spans differ in size.
[[nodiscard]] std::vector<Eigen::Vector3d> TriangulatePoints(
    const StereoRig& rig, std::span<const Eigen::Vector2d> left,
    std::span<const Eigen::Vector2d> right);

// d point_in_rig / d rig.Parameters() (3 x P, mm per parameter), the two pixels held; exact. NaN
// where Triangulate() reports a status.
[[nodiscard]] Eigen::MatrixXd TriangulationParameterJacobian(const StereoRig& rig,
                                                             const Eigen::Vector2d& left,
                                                             const Eigen::Vector2d& right);

}  // namespace plumbline
