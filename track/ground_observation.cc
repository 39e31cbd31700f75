#include "track/ground_observation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "fit/carcass_thickness.h"
#include "track/surface_plane.h"

namespace plumbline {
namespace {

using Of = PoseObservation::Of;

Image<Eigen::Vector3d> Moved(Image<Eigen::Vector3d> points_mm, const Image<Eigen::Vector3f>& by) {
  for (std::size_t i = 0; i < points_mm.pixel_count(); ++i) {
    points_mm.data()[i] += by.data()[i].cast<double>();
  }
  return points_mm;
}

Image<double> Sum(Image<double> values, const Image<double>& added) {
  for (std::size_t i = 0; i < values.pixel_count(); ++i) values.data()[i] += added.data()[i];
  return values;
}

// Pitch, roll, height above the lowest part and above the top.
using Heights = Eigen::Vector4d;

// Parts of which the lowest gives the pose; `top` is the index of an obstacle's.
class Parts {
 public:
  Parts(const TyrePoints& points, NormalOf normal_of, std::vector<GroundPlane> parts,
        std::optional<std::size_t> top)
      : points_(points), normal_of_(normal_of), parts_(std::move(parts)), top_(top) {}

  PoseObservation Observe(const WheelAxis& axis, bool on_ground) const {
    const ParallelPlanes all = MakeParallel(parts_, normal_of_);
    const Heights heights = HeightsOf(all, axis);
    PoseObservation observed;
    observed.time_s = points_.time_s;
    observed.of = on_ground ? Of::kPlane : Of::kTurns;
    observed.pose = heights.head<3>();
    const std::size_t top = top_.value_or(0);
    // Turns, offset of the lowest, offset of the top.
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(4, all.cov.cols());
    const Eigen::Matrix3d lowest = PoseJacobian(all.planes.front(), axis);
    J.topLeftCorner<3, 3>() = lowest;
    J.row(3).head<2>() = PoseJacobian(all.planes[top], axis).row(2).head<2>();
    J(3, 2 + static_cast<Eigen::Index>(top)) = -1;
    const Eigen::Matrix4d cov = J * all.cov * J.transpose();
    observed.cov = cov.topLeftCorner<3, 3>();
    if (top_) {
      observed.top.emplace();
      observed.top->below_axis_mm = heights[3];
      observed.top->cov = cov.col(3);
    }
    return observed;
  }

  // What other points, thickness, or marks of inliers make of it, less what was observed.
  Heights Less(const PoseObservation& observed, const WheelAxis& axis,
               const Image<Eigen::Vector3d>& point_mm, const Image<double>& thickness_mm,
               const std::vector<std::vector<std::uint8_t>>* marks = nullptr) const {
    std::vector<GroundPlane> parts = parts_;
    for (std::size_t k = 0; marks != nullptr && k < parts.size(); ++k) {
      parts[k].inlier = (*marks)[k];
    }
    parts = RefitParts(parts, point_mm, points_.cov_mm2, thickness_mm);
    Heights off = HeightsOf(MakeParallel(parts, normal_of_), axis);
    off.head<3>() -= observed.pose;
    off[3] -= observed.top ? observed.top->below_axis_mm : off[3];
    return off;
  }

 private:
  Heights HeightsOf(const ParallelPlanes& all, const WheelAxis& axis) const {
    Heights heights;
    heights << PoseOf(all.planes.front(), axis),
        all.planes[top_.value_or(0)].SignedDistance(axis.origin_in_rig_mm());
    return heights;
  }

  const TyrePoints& points_;
  NormalOf normal_of_;
  std::vector<GroundPlane> parts_;
  std::optional<std::size_t> top_;
};

void AddCommon(const Heights& off, std::size_t which, PoseObservation* observed) {
  observed->common[which] = off.head<3>();
  if (observed->top) observed->top->common_mm[which] = off[3];
}

void AddAlong(const TyrePoints& points, const WheelAxis& axis,
              std::span<const WheelAxis> axis_along_modes, const Parts& parts,
              PoseObservation* observed) {
  AddCommon(
      parts.Less(*observed, axis, points.point_mm, Sum(points.thickness_mm, points.left_out_mm)), 0,
      observed);
  const std::size_t modes = points.along_modes_mm.size();
  for (std::size_t k = 0; k < modes; ++k) {
    const Image<double>& thickness =
        ThicknessAlong(k, modes, points.thickness_mm, points.thickness_along_modes);
    const Heights off = parts.Less(*observed, axis_along_modes[k],
                                   Moved(points.point_mm, points.along_modes_mm[k]), thickness);
    observed->along_modes.emplace_back(off.head<3>());
    if (observed->top) observed->top->along_modes_mm.push_back(off[3]);
  }
  for (const Image<Eigen::Vector3f>& error : points.along_pose_mm) {
    const Heights off =
        parts.Less(*observed, axis, Moved(points.point_mm, error), points.thickness_mm);
    observed->cov += off.head<3>() * off.head<3>().transpose();
    if (observed->top) observed->top->cov += off * off[3];
  }
}

TopPlace PlaceOf(const GroundPlane& part, const Image<Eigen::Vector3d>& point_mm,
                 const WheelAxis& axis, double edge_mm) {
  constexpr double kMost = std::numeric_limits<double>::max();
  const Eigen::Vector3d across = axis.direction_in_rig();
  const Eigen::Vector3d along = across.cross(part.normal).normalized();
  TopPlace place{{kMost, -kMost}, {kMost, -kMost}};
  const auto take = [&](double at_mm, std::array<double, 2>* range) {
    (*range)[0] = std::min((*range)[0], at_mm - edge_mm);
    (*range)[1] = std::max((*range)[1], at_mm + edge_mm);
  };
  for (std::size_t i = 0; i < point_mm.pixel_count(); ++i) {
    if (part.inlier[i] == 0) continue;
    const Eigen::Vector3d from_axis = point_mm.data()[i] - axis.origin_in_rig_mm();
    take(along.dot(from_axis), &place.along_mm);
    take(across.dot(from_axis), &place.across_mm);
  }
  return place;
}

// The covariance of each narrow part, by what its points have in common: a strip is no wider than a
// subset or two.
void SetCovariances(const TyrePoints& points, const NeighbourCorrelation& neighbours,
                    std::vector<GroundPlane>* parts) {
  std::vector<std::size_t> places(points.point_mm.pixel_count());
  std::iota(places.begin(), places.end(), std::size_t{0});
  for (GroundPlane& part : *parts) {
    const Image<Eigen::Vector3d> outer =
        OuterPoints(points.point_mm, points.thickness_mm, part.normal);
    part.cov = PlaneCovariance(
        part, {outer.values(), points.cov_mm2.values(), places, outer.size()}, neighbours);
    part.cov *= std::max(1.0, part.scatter_ratio * part.scatter_ratio);
  }
}

// The largest part but the ground.
std::optional<std::size_t> TopOf(const ContactLevels& levels) {
  std::optional<std::size_t> top;
  std::ptrdiff_t most = 0;
  for (std::size_t k = levels.on_ground ? 1 : 0; k < levels.parts.size(); ++k) {
    const auto& inlier = levels.parts[k].inlier;
    const std::ptrdiff_t count = std::count(inlier.begin(), inlier.end(), 1);
    if (count <= most) continue;
    most = count;
    top = k;
  }
  return top;
}

bool Overlap(const std::array<double, 2>& a, const std::array<double, 2>& b, double b_moved_mm) {
  return a[0] < b[1] + b_moved_mm && b[0] + b_moved_mm < a[1];
}

class Observer {
 public:
  Observer(const TyrePoints& points, const WheelAxis& axis,
           std::span<const WheelAxis> axis_along_modes, const NeighbourCorrelation& neighbours,
           const GroundObservationOptions& options)
      : points_(points),
        axis_(axis),
        axis_along_modes_(axis_along_modes),
        neighbours_(neighbours),
        options_(options) {}

  GroundObservation Observe() const {
    std::string why_no_levels;
    const auto flat = FindFlatContact(points_.point_mm, points_.cov_mm2, points_.thickness_mm,
                                      axis_, options_.flat);
    auto levels = FindContactLevels(points_.point_mm, points_.cov_mm2, points_.thickness_mm, axis_,
                                    flat ? &flat->plane : nullptr, options_.levels, &why_no_levels);
    if (!flat && !levels) return {OfSymmetry(why_no_levels), {}};
    if (!levels) {
      levels.emplace();
      levels->parts.push_back(flat->plane);
      levels->on_ground = true;
    }
    if (!flat) SetCovariances(points_, neighbours_, &levels->parts);
    const auto top = TopOf(*levels);
    const Parts parts(points_, flat ? NormalOf::kFirst : NormalOf::kAll, levels->parts, top);
    GroundObservation out;
    out.pose = parts.Observe(axis_, levels->on_ground);
    AddAlong(points_, axis_, axis_along_modes_, parts, &out.pose);
    if (!flat) {
      AddCommon(parts.Less(out.pose, axis_, points_.point_mm, points_.thickness_mm,
                           &levels->at_other_edge),
                1, &out.pose);
      out.pose.over_obstacle = true;
    }
    if (!levels->on_ground) {
      out.pose.why = fmt::format(
          "the tyre stands on an obstacle's flat top with {:.0f} % of the points below it, and "
          "touches no ground that would tell how high that is",
          100 * levels->below_share);
    }
    if (top) {
      out.top = PlaceOf(levels->parts[*top], points_.point_mm, axis_, options_.levels.edge_mm);
    }
    return out;
  }

 private:
  PoseObservation OfSymmetry(const std::string& why) const {
    PoseObservation nothing;
    nothing.time_s = points_.time_s;
    std::string why_not;
    const auto symmetry = Symmetry(points_.point_mm, axis_, &why_not);
    if (!symmetry) {
      nothing.why = why + "; " + why_not;
      return nothing;
    }
    std::vector<double> along;
    for (std::size_t k = 0; k < points_.along_modes_mm.size(); ++k) {
      const auto there =
          Symmetry(Moved(points_.point_mm, points_.along_modes_mm[k]), axis_along_modes_[k]);
      along.push_back(there ? there->pitch_rad - symmetry->pitch_rad : 0);
    }
    PoseObservation pitch = ObservePitch(points_.time_s, *symmetry, along);
    pitch.why = why;
    for (const Image<Eigen::Vector3f>& error : points_.along_pose_mm) {
      const auto there = Symmetry(Moved(points_.point_mm, error), axis_);
      if (there) pitch.cov(0, 0) += std::pow(there->pitch_rad - symmetry->pitch_rad, 2);
    }
    return pitch;
  }

  std::optional<DeformationSymmetry> Symmetry(const Image<Eigen::Vector3d>& point_mm,
                                              const WheelAxis& axis,
                                              std::string* why = nullptr) const {
    return FindSymmetry(point_mm, points_.sigma_mm, axis, 0, options_.symmetry, why);
  }

  const TyrePoints& points_;
  const WheelAxis& axis_;
  std::span<const WheelAxis> axis_along_modes_;
  const NeighbourCorrelation& neighbours_;
  const GroundObservationOptions& options_;
};

}  // namespace

void GroundObservationOptions::Check() const {
  flat.Check();
  levels.Check();
  symmetry.Check();
}

GroundObservation ObserveGround(const TyrePoints& points, const WheelAxis& axis,
                                std::span<const WheelAxis> axis_along_modes,
                                const NeighbourCorrelation& neighbours,
                                const GroundObservationOptions& options) {
  options.Check();
  if (axis_along_modes.size() != points.along_modes_mm.size()) {
    throw std::invalid_argument("ObserveGround: not an axis for each calibration mode");
  }
  return Observer(points, axis, axis_along_modes, neighbours, options).Observe();
}

void LinkTops(std::span<const double> travel_mm, std::span<GroundObservation> frames) {
  if (travel_mm.size() != frames.size()) {
    throw std::invalid_argument("LinkTops: not a way for each frame");
  }
  std::optional<std::size_t> last;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    if (!frames[k].pose.top) continue;
    if (last) {
      const TopPlace &now = frames[k].top, &before = frames[*last].top;
      // The ground goes backwards under a wheel that rolls forwards.
      const double moved_mm = travel_mm[*last] - travel_mm[k];
      frames[k].pose.top->as_before = Overlap(now.along_mm, before.along_mm, moved_mm) &&
                                      Overlap(now.across_mm, before.across_mm, 0);
    }
    last = k;
  }
}

}  // namespace plumbline
