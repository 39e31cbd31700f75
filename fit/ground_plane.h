#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/rigid3.h"

namespace plumbline {

// A plane fitted to points: normal . point = offset_mm, in the frame of the points.
//
// `cov` has the order (rotation of the normal about e1 in rad, about e2 in rad, offset along the
// normal at the centroid in mm). e1, e2, normal are right-handed. The offset at the centroid, not
// at the frame's origin, is what the points determine: it is nearly independent of the rotations.
struct GroundPlane {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();   // unit, towards the cameras
  double offset_mm = 0;                                // never positive: the normal looks back
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();  // on the plane, amid the inliers (mm)
  Eigen::Vector3d e1 = Eigen::Vector3d::UnitX();       // unit, in the plane
  Eigen::Vector3d e2 = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();  // random part
  double rms_mm = 0;                              // of the inliers' distances from the plane
  double inlier_fraction = 0;                     // of the points that were usable
  double inlier_threshold_mm = 0;                 // that was applied; 0 after RefitPlane()
  // The inliers' scatter about the plane over what their covariances promise (1: as promised).
  // Where it exceeds 1, `cov` is scaled by its square.
  double scatter_ratio = 0;
  std::vector<std::uint8_t> inlier;  // 1 or 0 a point

  double SignedDistance(const Eigen::Vector3d& point_mm) const {
    return normal.dot(point_mm) - offset_mm;
  }
};

struct GroundPlaneOptions {
  double inlier_threshold_mm = 0;    // 0: from the points' own sigmas and scatter
  double min_inlier_fraction = 0.3;  // fewer points on one plane than this: no plane
  int min_points = 20;
  // A surface that bows by more than this share of its extent is not called a plane.
  double max_bow = 0.02;
  // How many neighbouring points share one and the same noise: a matcher's window of w x w px with
  // a point every s px makes (w / s)^2. The random covariance is that of independent points times
  // this. 1: independent.
  double correlation_area_points = 1;
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// RANSAC (PCL) for the inliers, then total least squares weighted with the points' covariances,
//   minimise sum rho(u),  u = (n . p - d) / sqrt(n' C n),  rho Huber's with k = 2.5,
// over a turn of the normal and a shift of the offset, with exact derivatives (of the denominator
// too: Gauss-Newton on u). The random covariance is the inverse of its normal matrix, times the
// square of the scatter ratio where that is above 1, times correlation_area_points.
//
// points_mm:  any frame whose origin lies on the cameras' side of the plane (the rig frame).
// cov_mm2:    one a point. Points or covariances that are not finite are left out.
// Throws InputError, with the reason, when no plane holds: too few points, too few on one plane,
// points along a line, a curved surface. Throws std::invalid_argument when the sizes differ.
//
// RANSAC sees at most 20 000 of them, drawn from the
// seed. The result is the same for any number of threads.
GroundPlane FitGroundPlane(std::span<const Eigen::Vector3d> points_mm,
                           std::span<const Eigen::Matrix3d> cov_mm2,
                           const GroundPlaneOptions& options = {});

// The same refinement with the inliers given (1 or 0 a point), nothing searched and nothing
// refused but fewer than three usable points: what calibration modes are propagated through.
GroundPlane RefitPlane(std::span<const Eigen::Vector3d> points_mm,
                       std::span<const Eigen::Matrix3d> cov_mm2,
                       std::span<const std::uint8_t> inlier, double correlation_area_points = 1);

// How `plane` differs from `reference`, in the order and basis of reference.cov.
Eigen::Vector3d PlaneDifference(const GroundPlane& reference, const GroundPlane& plane);

// The ground frame: z along the normal, x the direction of travel projected onto the plane, y to
// the left; origin on the plane below `origin_above` (the wheel axis or the patch's centroid).
// A travel direction of zero means that none is known: then the rig's x axis, or, where that is
// along the normal, its y axis. Throws InputError when the direction given is along the normal.
Rigid3 GroundFromRig(const GroundPlane& plane, const Eigen::Vector3d& travel_direction_in_rig,
                     const Eigen::Vector3d& origin_above);

}  // namespace plumbline
