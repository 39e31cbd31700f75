#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "calib/image.h"
#include "fit/contact_levels.h"
#include "fit/deformation_symmetry.h"
#include "fit/flat_contact.h"
#include "fit/wheel_axis.h"
#include "match/neighbour_correlation.h"
#include "track/rig_rotation.h"

namespace plumbline {

// The points of a tyre's inner surface in one frame, on their grid, rig frame, NaN where there is
// none. Keeps references.
struct TyrePoints {
  double time_s = 0;
  const Image<Eigen::Vector3d>& point_mm;
  const Image<Eigen::Matrix3d>& cov_mm2;  // random
  const Image<double>& thickness_mm;      // ThicknessOver()
  const Image<double>& left_out_mm;       // ThicknessLeftOutOver()
  double sigma_mm = 0;                    // about along the ground's normal
  // What each calibration mode does to the points, and to the thickness: of the last ones, which
  // are the carcass's (WithCarcassModes).
  std::span<const Image<Eigen::Vector3f>> along_modes_mm = {};
  std::span<const Image<double>> thickness_along_modes = {};
  // What one sigma of each direction of the frame's own pose of the cameras does to the points.
  std::span<const Image<Eigen::Vector3f>> along_pose_mm = {};
};

struct GroundObservationOptions {
  FlatContactOptions flat;
  ContactLevelOptions levels;
  SymmetryOptions symmetry;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Where a top is seen: along the wheel's heading and along its axis, from the axis' origin.
struct TopPlace {
  std::array<double, 2> along_mm{}, across_mm{};
};

struct GroundObservation {
  PoseObservation pose;
  TopPlace top;  // where pose.top is
};

// What a frame says of the pose by itself, of the first of these that is there:
//
//   the plane of a wide flat contact (FindFlatContact): all of it;
//   narrow flat contacts (FindContactLevels), on the ground: all of it, or on the flat top of an
//     obstacle alone: pitch and roll;
//   the symmetry of the deformation (FindSymmetry): pitch;
//   nothing; `why` says why there is no plane.
//
// The height of the axis above an obstacle's flat top is told wherever one is seen. What the
// curve between the entries of the carcass's map leaves out, and for narrow contacts what another
// edge makes of them, are errors common to all frames.
//
// axis_along_modes: an axis for each mode. Throws as these functions do.
[[nodiscard]] GroundObservation ObserveGround(const TyrePoints& points, const WheelAxis& axis,
                                              std::span<const WheelAxis> axis_along_modes,
                                              const NeighbourCorrelation& neighbours,
                                              const GroundObservationOptions& options = {});

// Marks the tops that are those of the last frame before that has one: on the ground, the way of
// the wheel between the frames taken off, they overlap. travel_mm: of each frame, against any one;
// NaN, as of a frame that was not placed, overlaps nothing. The frames in their order.
void LinkTops(std::span<const double> travel_mm, std::span<GroundObservation> frames);

}  // namespace plumbline
