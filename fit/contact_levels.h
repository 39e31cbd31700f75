#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/image.h"
#include "fit/flat_contact.h"
#include "fit/ground_plane.h"
#include "fit/wheel_axis.h"

namespace plumbline {

// The flat parts of a tyre over an obstacle: on its top, and on the ground beside it, where they
// are too narrow for FindFlatContact() or one above the other.
//
// The flat top of an obstacle that lies on the ground (a bar of rectangular section, a nut, a
// plank) is taken to be parallel to the ground, so that all parts have one normal; how far they
// are one above the other is not assumed. What is not parallel to the rest, beyond its own sigma,
// is left out. The points beside the top's edge, where a carcass bends over it, tilt a narrow
// strip: as in FlatContactOptions only those count that are further from it than edge_mm.
struct ContactLevelOptions {
  double edge_mm = 8;
  // The largest part, without its edge, in its narrower and its longer direction.
  double least_extent_mm = 18, least_length_mm = 35;
  double least_extent_beside_mm = 8;  // of every other part, in its narrower direction
  int least_points = 20;
  // Of a part, as in FlatContactOptions. In its narrower direction, by which an obstacle's edge and
  // a round surface differ from a strip, a third of that, or what noise makes if that is more.
  double max_bow_mm = 0.15;
  double max_roll_rad = 0.26;    // of the wheel's axis against the parts
  double max_below_share = 0.1;  // of points below the lowest part: more, and it is no ground
  int most_levels = 3;
  // More of a turn against the rest, over the sigma of noise and this: not parallel.
  double parallel_rad = 5e-4;
  double correlation_area_points = 1;  // as in GroundPlaneOptions
  std::uint64_t seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct ContactLevels {
  // Each part by itself, RefitPlane() of its points; the first is the lowest.
  std::vector<GroundPlane> parts;
  bool on_ground = false;   // the lowest one is the ground
  double below_share = 0;   // of the points, below the lowest one
  std::size_t largest = 0;  // of the parts, by the number of its points
  // Inliers of the same parts with an edge half as wide again (where too little is left, one third
  // narrower), to tell what the edge does; of a ground that was given, its own.
  std::vector<std::vector<std::uint8_t>> at_other_edge;
};

// The largest part is drawn as in FindFlatContact(), without a penalty for what lies below it. The
// others are looked for on planes parallel to it, at the heights at which most points lie, until
// none has enough of them. Where `ground` is given it is the first part, as it is.
//
// point_mm, cov_mm2, thickness_mm: as in FindFlatContact(). Nothing where no part is flat, or none
// but the ground that was given; the reason is then in *why, if given. Throws as FindFlatContact().
// Accuracy: tests/fit/contact_levels_test.cc. The same for any number of threads.
[[nodiscard]] std::optional<ContactLevels> FindContactLevels(
    const Image<Eigen::Vector3d>& point_mm, const Image<Eigen::Matrix3d>& cov_mm2,
    const Image<double>& thickness_mm, const WheelAxis& axis, const GroundPlane* ground,
    const ContactLevelOptions& options = {}, std::string* why = nullptr);

// Planes with one normal in common.
struct ParallelPlanes {
  // normal, offset, centroid, e1, e2 of each; e1 and e2 are the same for all. `cov` of each is that
  // of itself: of the normal's turns and of its own offset.
  std::vector<GroundPlane> planes;
  // Turn about e1, about e2 (rad), offset of each at its centroid (mm).
  Eigen::MatrixXd cov;
};

enum class NormalOf { kAll, kFirst };
// Least squares over the turns of the parts, weighted with their `cov`: each part says something of
// the normal, or the first one all of it, and each all of its own offset. Throws
// std::invalid_argument without a part.
[[nodiscard]] ParallelPlanes MakeParallel(std::span<const GroundPlane> parts,
                                          NormalOf normal_of = NormalOf::kAll);

// The parts through the same points, moved: as along a calibration mode, or with another carcass.
// Their covariances stay.
[[nodiscard]] std::vector<GroundPlane> RefitParts(std::span<const GroundPlane> parts,
                                                  const Image<Eigen::Vector3d>& point_mm,
                                                  const Image<Eigen::Matrix3d>& cov_mm2,
                                                  const Image<double>& thickness_mm);

}  // namespace plumbline
