#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/rigid3.h"

namespace plumbline {

// A plane fitted to points: normal . point = offset_mm. `cov` has the order (rotation of the normal
// about e1, about e2 in rad, offset in mm at the centroid), with the basis e1, e2 stated.
struct GroundPlane {
  Eigen::Vector3d normal;  // unit, towards the cameras
  double offset_mm =
      0;  // negative when the plane lies in front of the rig and the normal looks back at it
  Eigen::Vector3d centroid;  // mm, of the inliers
  Eigen::Vector3d e1, e2;    // unit, in the plane
  Eigen::Matrix3d cov;       // random part
  double rms_mm = 0;         // of the inliers' distances
  double inlier_fraction = 0;
  std::vector<std::uint8_t> inlier;  // 1 or 0 a point
};

struct GroundPlaneOptions {
  double inlier_threshold_mm = 0;  // 0: from the points' own sigmas and scatter
  double min_inlier_fraction = 0.3;
  std::uint64_t seed = 1;
  void Check() const;
};

// RANSAC (PCL) for the inliers, then weighted total least squares with the points' covariances and
// a robust loss. Points that are NaN are left out. Throws InputError, with the reason, when no
// plane holds.
GroundPlane FitGroundPlane(std::span<const Eigen::Vector3d> points_mm,
                           std::span<const Eigen::Matrix3d> cov_mm2,
                           const GroundPlaneOptions& options = {});

// The ground frame of DESIGN.md: z along the normal, x the direction of travel (projected), origin
// on the plane below `origin_above` (the wheel axis or the patch's centroid).
Rigid3 GroundFromRig(const GroundPlane& plane, const Eigen::Vector3d& travel_direction_in_rig,
                     const Eigen::Vector3d& origin_above);

}  // namespace plumbline
