#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>

#include "calib/image.h"
#include "fit/ground_plane.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// The ground under a tyre, from its inner surface: where the carcass lies flat on the ground, the
// ground is its thickness below.
//
// A tyre does not leave the ground at an edge but along a rounded corner: over some millimetres the
// gap is smaller than the noise, and such points, taken for flat, would tilt the plane. So a point
// only counts where all others within edge_mm of it are flat too. Over an obstacle the surface is
// lifted as at the edge of the patch, so that the same rule leaves the obstacle and its
// surroundings out: the plane is that of the flat ground beside it.
struct FlatContactOptions {
  double edge_mm = 12;
  // The flat part has to extend so far in its narrower direction, without the edge.
  double least_extent_mm = 45;
  int least_points = 20;
  double max_bow_mm = 0.15;      // of the flat part, from its middle to its rim: more is not flat
  double max_roll_rad = 0.26;    // of the wheel's axis against the ground
  double max_below_share = 0.1;  // of points below the plane: more, and it is an obstacle's top
  double correlation_area_points = 1;  // as in GroundPlaneOptions
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct FlatContact {
  // Of the ground, in the rig frame. `inlier`: the flat part, an entry a point of the grid.
  GroundPlane plane;
  double below_share = 0;  // of the points, further below the plane than noise explains
};

// point_mm: the inner surface in the rig frame, NaN where there is none; cov_mm2: of each point,
// from noise; thickness_mm: of the carcass over it (ThicknessOver).
//
// Planes through three outer points near to each other are drawn at random; the one that most
// points lie on, less twice those below it, is refined by RefitPlane() on the flat part until that
// stays the same. Nothing where no part is flat; the reason is then in *why, if given. The random
// covariance is that of RefitPlane(); PlaneCovariance() with OuterPoints() makes a better one.
// Throws UsageError from the options, std::invalid_argument where sizes differ.
// Accuracy: tests/fit/flat_contact_test.cc. The same for any number of threads.
[[nodiscard]] std::optional<FlatContact> FindFlatContact(const Image<Eigen::Vector3d>& point_mm,
                                                         const Image<Eigen::Matrix3d>& cov_mm2,
                                                         const Image<double>& thickness_mm,
                                                         const WheelAxis& axis,
                                                         const FlatContactOptions& options = {},
                                                         std::string* why = nullptr);

// The inner surface moved towards the ground by the carcass's thickness, along the ground's normal:
// where it is in contact, its outer side. What the plane is fitted to.
[[nodiscard]] Image<Eigen::Vector3d> OuterPoints(const Image<Eigen::Vector3d>& point_mm,
                                                 const Image<double>& thickness_mm,
                                                 const Eigen::Vector3d& ground_normal);

// The plane through the same flat part of other points, as along a calibration mode.
[[nodiscard]] GroundPlane RefitFlatContact(const FlatContact& flat,
                                           const Image<Eigen::Vector3d>& point_mm,
                                           const Image<Eigen::Matrix3d>& cov_mm2,
                                           const Image<double>& thickness_mm);

}  // namespace plumbline
