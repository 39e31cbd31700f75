#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "calib/status.h"
#include "calib/stereo_rig.h"

namespace plumbline {

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
  double epipolar_px =
      0;  // signed distance of the right pixel from the epipolar line of the left one
  double sigma_epipolar_px = 0;
  Status status = Status::kOk;
};

// Triangulates one stereo correspondence and propagates its covariance.
[[nodiscard]] TriangulatedPoint Triangulate(const StereoRig& rig,
                                            const StereoObservation& observation);

// Many at once, in parallel.
[[nodiscard]] std::vector<TriangulatedPoint> Triangulate(
    const StereoRig& rig, std::span<const StereoObservation> observations);

// The points alone, for re-evaluation along calibration modes: NaN where Triangulate() reports a
// status.
[[nodiscard]] std::vector<Eigen::Vector3d> TriangulatePoints(
    const StereoRig& rig, std::span<const Eigen::Vector2d> left,
    std::span<const Eigen::Vector2d> right);

}  // namespace plumbline
