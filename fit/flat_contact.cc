#include "fit/flat_contact.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "fit/internal/flat_search.h"

namespace plumbline {
namespace {

using internal::FlatExtent;
using internal::FlatPlane;
using internal::FlatSearch;

constexpr int kRounds = 12;

std::nullopt_t No(std::string* why, std::string reason) {
  if (why != nullptr) *why = std::move(reason);
  return std::nullopt;
}

std::size_t CountOf(const std::vector<std::uint8_t>& marks) {
  return static_cast<std::size_t>(std::count(marks.begin(), marks.end(), 1));
}

}  // namespace

void FlatContactOptions::Check() const {
  if (!(edge_mm >= 0) || !(least_extent_mm > 0) || !(max_bow_mm > 0)) {
    throw UsageError("Edge, extent and bow of the flat part of a patch must be positive.");
  }
  internal::CheckFlatSearch(least_points, max_roll_rad, max_below_share, correlation_area_points);
}

Image<Eigen::Vector3d> OuterPoints(const Image<Eigen::Vector3d>& point_mm,
                                   const Image<double>& thickness_mm,
                                   const Eigen::Vector3d& ground_normal) {
  if (point_mm.size() != thickness_mm.size()) {
    throw std::invalid_argument("OuterPoints: points and thickness are of different grids");
  }
  Image<Eigen::Vector3d> outer(point_mm.size(), Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < outer.pixel_count(); ++i) {
    outer.data()[i] = point_mm.data()[i] - thickness_mm.data()[i] * ground_normal;
  }
  return outer;
}

GroundPlane RefitFlatContact(const FlatContact& flat, const Image<Eigen::Vector3d>& point_mm,
                             const Image<Eigen::Matrix3d>& cov_mm2,
                             const Image<double>& thickness_mm) {
  GroundPlane plane = flat.plane;
  // The carcass's thickness counts along the normal that is looked for; its cosine is of second
  // order, so that twice is enough.
  for (int round = 0; round < 2; ++round) {
    plane = RefitPlane(OuterPoints(point_mm, thickness_mm, plane.normal).values(), cov_mm2.values(),
                       flat.plane.inlier);
  }
  return plane;
}

std::optional<FlatContact> FindFlatContact(const Image<Eigen::Vector3d>& point_mm,
                                           const Image<Eigen::Matrix3d>& cov_mm2,
                                           const Image<double>& thickness_mm, const WheelAxis& axis,
                                           const FlatContactOptions& options, std::string* why) {
  options.Check();
  if (point_mm.size() != thickness_mm.size() || point_mm.size() != cov_mm2.size()) {
    throw std::invalid_argument("FindFlatContact: images of different grids");
  }
  const FlatSearch search(point_mm, cov_mm2, thickness_mm, axis);
  const std::size_t usable = search.usable().size();
  if (!search.HasGrid() || usable < static_cast<std::size_t>(options.least_points)) {
    return No(why, fmt::format("only {} points are there", usable));
  }
  const std::optional<FlatPlane> drawn =
      search.DrawPlane({.least_score = static_cast<double>(options.least_points),
                        .max_roll_rad = options.max_roll_rad,
                        .seed = options.seed});
  if (!drawn) return No(why, "no part of the surface is flat");
  FlatPlane plane = *drawn;
  FlatContact found;
  std::vector<std::uint8_t> flat;
  Image<Eigen::Vector3d> outer;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<std::uint8_t> next =
        search.FlatPart(plane, options.edge_mm, FlatSearch::Off::kAbove);
    if (CountOf(next) < static_cast<std::size_t>(options.least_points)) {
      return No(why, fmt::format("no part of the surface is flat beyond {:g} mm from where it "
                                 "lifts off",
                                 options.edge_mm));
    }
    if (next == flat) break;
    flat = std::move(next);
    outer = OuterPoints(point_mm, thickness_mm, plane.normal);
    found.plane =
        RefitPlane(outer.values(), cov_mm2.values(), flat, options.correlation_area_points);
    plane = {found.plane.normal, found.plane.offset_mm};
  }
  found.below_share = search.BelowShare(plane);
  if (found.below_share > options.max_below_share) {
    return No(why, fmt::format("{:.0f} % of the points lie below the flat part: it is no ground",
                               100 * found.below_share));
  }
  const FlatExtent extent = internal::ExtentOf(found.plane, outer);
  if (extent.narrow_mm < options.least_extent_mm) {
    return No(why, fmt::format("the flat part is {:.0f} mm wide and {:g} mm are needed",
                               extent.narrow_mm, options.least_extent_mm));
  }
  if (extent.bow_mm > options.max_bow_mm) {
    return No(why,
              fmt::format("the flattest part of the surface bows by {:.2f} mm", extent.bow_mm));
  }
  return found;
}

}  // namespace plumbline
