#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include "calib/image.h"
#include "fit/ground_plane.h"
#include "fit/wheel_axis.h"

namespace plumbline::internal {

// What the options of all that is looked for with it have in common. Throws UsageError naming the
// broken constraint.
void CheckFlatSearch(int least_points, double max_roll_rad, double max_below_share,
                     double correlation_area_points);

struct FlatPlane {
  Eigen::Vector3d normal;
  double offset_mm;
};

// What a tyre's inner surface, with the carcass over it, has of flat parts (fit/flat_contact.h,
// fit/contact_levels.h). Keeps references to what it is made of.
class FlatSearch {
 public:
  FlatSearch(const Image<Eigen::Vector3d>& point, const Image<Eigen::Matrix3d>& cov,
             const Image<double>& thickness, const WheelAxis& axis);

  const std::vector<std::size_t>& usable() const { return usable_; }
  bool HasGrid() const { return pitch_mm_ > 0; }
  double threshold_mm() const { return threshold_mm_; }  // of a gap that noise explains

  // Height of a point's outer side above a plane, were it in contact.
  double Gap(const FlatPlane& plane, std::size_t i) const {
    return plane.normal.dot(point_.data()[i]) - thickness_.data()[i] - plane.offset_mm;
  }

  // The plane that most points lie on, less below_weight times those below it, out of planes
  // through three outer points near to each other. Nothing where that is no more than least_score.
  struct Draw {
    double least_score = 0;
    double below_weight = 2;
    double max_roll_rad = 0;  // of the wheel's axis against the plane
    std::uint64_t seed = 1;
  };
  std::optional<FlatPlane> DrawPlane(const Draw& draw) const;

  // Places that are flat on the plane and further than edge_mm from all that is lifted off it, or,
  // on an obstacle, that is off it at all or not seen (flanks are too steep to be matched): 1 or 0
  // a point of the grid.
  enum class Off { kAbove, kAboveOrBelow };
  std::vector<std::uint8_t> FlatPart(const FlatPlane& plane, double edge_mm, Off off) const;

  // Of the points, further below the plane than noise explains.
  double BelowShare(const FlatPlane& plane) const;

 private:
  double Sigma(const FlatPlane& plane, std::size_t i) const;
  std::optional<FlatPlane> ThroughThree(double max_roll_rad, std::mt19937_64& random) const;
  Image<double> Smoothed(const Image<double>& gap) const;
  Image<std::uint8_t> Unseen() const;
  bool FarFrom(const Image<std::uint8_t>& marked, std::size_t i, double edge_mm) const;

  const Image<Eigen::Vector3d>& point_;
  const Image<Eigen::Matrix3d>& cov_;
  const Image<double>& thickness_;
  const WheelAxis& axis_;
  std::vector<std::size_t> usable_;
  double pitch_mm_ = 0, threshold_mm_ = 0;
};

// Of a flat part: its extents, were it evenly filled, and how far a paraboloid through its points
// departs from a plane over twice their rms distance from the middle; in the narrower direction
// alone.
struct FlatExtent {
  double narrow_mm = 0, long_mm = 0, bow_mm = 0, narrow_bow_mm = 0;
};
// outer: the points that plane.inlier tells of.
FlatExtent ExtentOf(const GroundPlane& plane, const Image<Eigen::Vector3d>& outer);

}  // namespace plumbline::internal
