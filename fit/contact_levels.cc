#include "fit/contact_levels.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "fit/internal/flat_search.h"

namespace plumbline {
namespace {

using internal::FlatExtent;
using internal::FlatPlane;
using internal::FlatSearch;
using Marks = std::vector<std::uint8_t>;

constexpr int kRounds = 12, kLevelled = 4;
constexpr int kHeights = 6;     // at which parts beside the largest one are looked for
constexpr double kWider = 1.5;  // the other edge, over edge_mm
// Three sigmas of a bow over the sigma of the mean: for points evenly spread over a square its
// coefficient has 4.5 of the latter.
constexpr double kBowSigmas = 13;
constexpr double kNotParallel = 18;  // chi-square of two turns, 1e-4

std::nullopt_t No(std::string* why, std::string reason) {
  if (why != nullptr) *why = std::move(reason);
  return std::nullopt;
}

std::size_t CountOf(const Marks& marks) {
  return static_cast<std::size_t>(std::count(marks.begin(), marks.end(), 1));
}

class LevelSearch {
 public:
  LevelSearch(const Image<Eigen::Vector3d>& point, const Image<Eigen::Matrix3d>& cov,
              const Image<double>& thickness, const WheelAxis& axis,
              const ContactLevelOptions& options)
      : point_(point),
        cov_(cov),
        thickness_(thickness),
        options_(options),
        search_(point, cov, thickness, axis) {}

  const FlatSearch& search() const { return search_; }

  std::optional<GroundPlane> Largest(std::string* why) const {
    const auto drawn = search_.DrawPlane({.least_score = static_cast<double>(options_.least_points),
                                          .below_weight = 0,
                                          .max_roll_rad = options_.max_roll_rad,
                                          .seed = options_.seed});
    if (!drawn) return No(why, "no part of the surface is flat");
    const auto plane = Refined(Levelled(*drawn), true);
    if (!plane) {
      return No(why, fmt::format("no part of the surface is flat beyond {:g} mm from its edge",
                                 options_.edge_mm));
    }
    const FlatExtent extent = ExtentOf(*plane);
    if (extent.narrow_mm < options_.least_extent_mm || extent.long_mm < options_.least_length_mm) {
      return No(why, fmt::format("the largest flat part is {:.0f} by {:.0f} mm and {:g} by {:g} "
                                 "are needed",
                                 extent.long_mm, extent.narrow_mm, options_.least_length_mm,
                                 options_.least_extent_mm));
    }
    if (!IsFlat(*plane, extent)) {
      return No(why,
                fmt::format("the flattest part of the surface bows by {:.2f} mm", extent.bow_mm));
    }
    return plane;
  }

  // Parallel to the first part, at the height at which most other points lie.
  void AddLevels(std::vector<GroundPlane>* parts) const {
    Marks taken(point_.pixel_count(), 0);
    const FlatPlane base = Of(parts->front());
    Take(base, &taken);
    for (int k = 0; k < kHeights && static_cast<int>(parts->size()) < options_.most_levels; ++k) {
      const auto height_mm = FullestHeight(base, taken);
      if (!height_mm) return;
      const FlatPlane there{base.normal, base.offset_mm + *height_mm};
      Take(there, &taken);
      auto plane = Refined(there, false);
      if (!plane) continue;
      // What lies within the gap's threshold of a parallel plane is nearly parallel anyhow.
      const auto by_itself = Refined(Of(*plane), true);
      const FlatExtent extent = ExtentOf(*plane);
      if (extent.narrow_mm < options_.least_extent_beside_mm || !IsFlat(*plane, extent) ||
          !IsParallel(parts->front(), by_itself.value_or(*plane))) {
        continue;
      }
      parts->push_back(std::move(*plane));
    }
  }

  Marks AtEdge(const GroundPlane& plane, double factor) const {
    return search_.FlatPart(Of(plane), factor * options_.edge_mm, kOff);
  }

 private:
  static constexpr FlatSearch::Off kOff = FlatSearch::Off::kAboveOrBelow;

  static FlatPlane Of(const GroundPlane& plane) { return {plane.normal, plane.offset_mm}; }

  FlatExtent ExtentOf(const GroundPlane& plane) const {
    return internal::ExtentOf(plane, OuterPoints(point_, thickness_, plane.normal));
  }

  GroundPlane Refit(const Eigen::Vector3d& normal, const Marks& marks) const {
    return RefitPlane(OuterPoints(point_, thickness_, normal).values(), cov_.values(), marks,
                      options_.correlation_area_points);
  }

  // The plane of the flat part about `plane`; freely, or with its height alone refined until the
  // part stays the same (a small part would turn by its own noise).
  std::optional<GroundPlane> Refined(FlatPlane plane, bool freely) const {
    Marks flat;
    GroundPlane refined;
    for (int round = 0; round < kRounds; ++round) {
      Marks next = search_.FlatPart(plane, options_.edge_mm, kOff);
      if (CountOf(next) < static_cast<std::size_t>(options_.least_points)) return std::nullopt;
      if (next == flat) break;
      flat = std::move(next);
      refined = Refit(plane.normal, flat);
      if (freely) {
        plane = Of(refined);
      } else {
        plane.offset_mm = plane.normal.dot(refined.centroid);
      }
    }
    return refined;
  }

  // A plane through three points of a narrow strip is tilted, and what is tilted finds its edges
  // too late: so first through all points near it, their edges on both sides.
  FlatPlane Levelled(FlatPlane plane) const {
    for (int round = 0; round < kLevelled; ++round) {
      Marks near(point_.pixel_count(), 0);
      for (const std::size_t i : search_.usable()) {
        if (std::abs(search_.Gap(plane, i)) < search_.threshold_mm()) near[i] = 1;
      }
      plane = Of(Refit(plane.normal, near));
    }
    return plane;
  }

  void Take(const FlatPlane& plane, Marks* taken) const {
    for (const std::size_t i : search_.usable()) {
      if (std::abs(search_.Gap(plane, i)) < 2 * search_.threshold_mm()) (*taken)[i] = 1;
    }
  }

  std::optional<double> FullestHeight(const FlatPlane& base, const Marks& taken) const {
    std::vector<double> gaps;
    for (const std::size_t i : search_.usable()) {
      if (taken[i] == 0) gaps.push_back(search_.Gap(base, i));
    }
    std::sort(gaps.begin(), gaps.end());
    const double width_mm = 2 * search_.threshold_mm();
    std::size_t best = 0, first = 0;
    double height_mm = 0;
    for (std::size_t last = 0; last < gaps.size(); ++last) {
      while (gaps[last] - gaps[first] > width_mm) ++first;
      if (last - first + 1 <= best) continue;
      best = last - first + 1;
      height_mm = gaps[(first + last) / 2];
    }
    if (best < static_cast<std::size_t>(options_.least_points)) return std::nullopt;
    return height_mm;
  }

  bool IsFlat(const GroundPlane& plane, const FlatExtent& extent) const {
    const double noise_mm = kBowSigmas * std::sqrt(plane.cov(2, 2));
    return extent.bow_mm <= options_.max_bow_mm &&
           extent.narrow_bow_mm <= std::max(noise_mm, options_.max_bow_mm / 3);
  }

  bool IsParallel(const GroundPlane& base, const GroundPlane& part) const {
    const Eigen::Vector2d turn = PlaneDifference(part, base).head<2>();
    Eigen::Matrix2d cov = part.cov.topLeftCorner<2, 2>();
    // The other's share of it by its traces: an upper bound whichever way its basis lies.
    const double base_rad2 = base.cov.topLeftCorner<2, 2>().trace();
    cov.diagonal().array() += base_rad2 + options_.parallel_rad * options_.parallel_rad;
    return turn.dot(cov.ldlt().solve(turn)) < kNotParallel;
  }

  const Image<Eigen::Vector3d>& point_;
  const Image<Eigen::Matrix3d>& cov_;
  const Image<double>& thickness_;
  const ContactLevelOptions& options_;
  FlatSearch search_;
};

}  // namespace

void ContactLevelOptions::Check() const {
  if (!(edge_mm > 0) || !(least_extent_mm > 0) || !(least_length_mm > 0) ||
      !(least_extent_beside_mm > 0) || !(max_bow_mm > 0) || !(parallel_rad > 0)) {
    throw UsageError("Edge, extents, bow and turn of the flat parts must be positive.");
  }
  if (most_levels < 1) throw UsageError("At least one flat part has to be looked for.");
  internal::CheckFlatSearch(least_points, max_roll_rad, max_below_share, correlation_area_points);
}

std::optional<ContactLevels> FindContactLevels(const Image<Eigen::Vector3d>& point_mm,
                                               const Image<Eigen::Matrix3d>& cov_mm2,
                                               const Image<double>& thickness_mm,
                                               const WheelAxis& axis, const GroundPlane* ground,
                                               const ContactLevelOptions& options,
                                               std::string* why) {
  options.Check();
  if (point_mm.size() != thickness_mm.size() || point_mm.size() != cov_mm2.size()) {
    throw std::invalid_argument("FindContactLevels: images of different grids");
  }
  const LevelSearch levels(point_mm, cov_mm2, thickness_mm, axis, options);
  const std::size_t usable = levels.search().usable().size();
  if (!levels.search().HasGrid() || usable < static_cast<std::size_t>(options.least_points)) {
    return No(why, fmt::format("only {} points are there", usable));
  }
  ContactLevels found;
  const auto first = ground != nullptr ? std::optional(*ground) : levels.Largest(why);
  if (!first) return std::nullopt;
  found.parts.push_back(*first);
  levels.AddLevels(&found.parts);
  if (ground != nullptr && found.parts.size() == 1)
    return No(why, "nothing but the ground is flat");
  const Eigen::Vector3d up = first->normal;
  std::stable_sort(found.parts.begin(), found.parts.end(), [&](const auto& a, const auto& b) {
    return up.dot(a.centroid) < up.dot(b.centroid);
  });
  std::size_t most = 0;
  for (std::size_t k = 0; k < found.parts.size(); ++k) {
    const std::size_t count = CountOf(found.parts[k].inlier);
    if (count > most) {
      most = count;
      found.largest = k;
    }
  }
  const GroundPlane& lowest = found.parts.front();
  found.below_share = levels.search().BelowShare({up, up.dot(lowest.centroid)});
  found.on_ground = found.below_share <= options.max_below_share;
  for (const GroundPlane& part : found.parts) {
    if (ground != nullptr && part.inlier == ground->inlier) {
      found.at_other_edge.push_back(part.inlier);
      continue;
    }
    Marks wider = levels.AtEdge(part, kWider);
    if (CountOf(wider) < static_cast<std::size_t>(options.least_points)) {
      wider = levels.AtEdge(part, 1 / kWider);
    }
    found.at_other_edge.push_back(std::move(wider));
  }
  return found;
}

ParallelPlanes MakeParallel(std::span<const GroundPlane> parts, NormalOf normal_of) {
  if (parts.empty()) throw std::invalid_argument("MakeParallel: no part");
  const GroundPlane& first = parts.front();
  const auto count = static_cast<Eigen::Index>(parts.size());
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(2 + count, 2 + count);
  Eigen::VectorXd rhs = Eigen::VectorXd::Zero(2 + count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const GroundPlane& part = parts[static_cast<std::size_t>(k)];
    // From the part's own basis into that of the first.
    Eigen::Matrix3d basis = Eigen::Matrix3d::Identity();
    basis.topLeftCorner<2, 2>() << first.e1.dot(part.e1), first.e1.dot(part.e2),
        first.e2.dot(part.e1), first.e2.dot(part.e2);
    Eigen::Matrix3d weight = (basis * part.cov * basis.transpose()).inverse();
    if (k > 0 && normal_of == NormalOf::kFirst) {
      weight.row(0).setZero();
      weight.row(1).setZero();
      weight(2, 0) = weight(2, 1) = 0;
    }
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(3, 2 + count);
    J(0, 0) = J(1, 1) = J(2, 2 + k) = 1;
    Eigen::Vector3d says = PlaneDifference(first, part);
    says[2] = 0;
    normal += J.transpose() * weight * J;
    rhs += J.transpose() * (weight * says);
  }
  ParallelPlanes all;
  all.cov = normal.inverse();
  const Eigen::VectorXd solution = all.cov * rhs;
  const Eigen::Vector3d up =
      RotationFromVector(solution[0] * first.e1 + solution[1] * first.e2) * first.normal;
  for (Eigen::Index k = 0; k < count; ++k) {
    GroundPlane plane = parts[static_cast<std::size_t>(k)];
    plane.normal = up;
    plane.centroid += solution[2 + k] * up;
    plane.offset_mm = up.dot(plane.centroid);
    plane.e1 = (first.e1 - first.e1.dot(up) * up).normalized();
    plane.e2 = up.cross(plane.e1);
    const Eigen::Index at[3] = {0, 1, 2 + k};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) plane.cov(i, j) = all.cov(at[i], at[j]);
    }
    all.planes.push_back(std::move(plane));
  }
  return all;
}

std::vector<GroundPlane> RefitParts(std::span<const GroundPlane> parts,
                                    const Image<Eigen::Vector3d>& point_mm,
                                    const Image<Eigen::Matrix3d>& cov_mm2,
                                    const Image<double>& thickness_mm) {
  std::vector<GroundPlane> refitted(parts.begin(), parts.end());
  for (GroundPlane& plane : refitted) {
    const Eigen::Matrix3d cov = plane.cov;
    const Eigen::Vector3d e1 = plane.e1;
    for (int round = 0; round < 2; ++round) {
      plane = RefitPlane(OuterPoints(point_mm, thickness_mm, plane.normal).values(),
                         cov_mm2.values(), plane.inlier);
    }
    // The same basis as before, as `cov` has it.
    plane.e1 = (e1 - e1.dot(plane.normal) * plane.normal).normalized();
    plane.e2 = plane.normal.cross(plane.e1);
    plane.cov = cov;
  }
  return refitted;
}

}  // namespace plumbline
