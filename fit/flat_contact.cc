#include "fit/flat_contact.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

constexpr int kDraws = 1200;
constexpr std::size_t kScored = 1500;  // points that a drawn plane is held against
constexpr double kNear_mm = 70;        // a drawn triangle is no larger
constexpr double kSlender_mm = 15;     // nor lower
constexpr double kLeastThreshold_mm = 0.06;
constexpr double kSmoothed_mm = 6;  // gaps are told as medians over such a half width
constexpr double kLeastLift_mm = 0.03;
constexpr double kSigmas = 3.5;
constexpr int kRounds = 12;

struct Plane {
  Eigen::Vector3d normal;
  double offset_mm;
};

class FlatSearch {
 public:
  FlatSearch(const Image<Eigen::Vector3d>& point, const Image<Eigen::Matrix3d>& cov,
             const Image<double>& thickness, const WheelAxis& axis,
             const FlatContactOptions& options)
      : point_(point), cov_(cov), thickness_(thickness), axis_(axis), options_(options) {
    std::vector<double> sigmas, pitches;
    for (std::size_t i = 0; i < point.pixel_count(); ++i) {
      if (!point.data()[i].allFinite() || !cov.data()[i].allFinite() ||
          !std::isfinite(thickness.data()[i])) {
        continue;
      }
      usable_.push_back(i);
      // Along the viewing ray, near which the ground's normal lies.
      const Eigen::Vector3d ray = point.data()[i].normalized();
      sigmas.push_back(std::sqrt(std::max(0.0, ray.dot(cov.data()[i] * ray))));
      const auto column = static_cast<int>(i % static_cast<std::size_t>(point.width()));
      if (column == 0 || !point.data()[i - 1].allFinite()) continue;
      pitches.push_back((point.data()[i] - point.data()[i - 1]).norm());
    }
    if (pitches.empty()) return;
    pitch_mm_ = Median(std::move(pitches));
    threshold_mm_ = std::max(kLeastThreshold_mm, 3 * Median(std::move(sigmas)));
  }

  std::size_t usable() const { return usable_.size(); }
  bool HasGrid() const { return pitch_mm_ > 0; }

  // Height of a point's outer side above a plane, were it in contact.
  double Gap(const Plane& plane, std::size_t i) const {
    return plane.normal.dot(point_.data()[i]) - thickness_.data()[i] - plane.offset_mm;
  }

  std::optional<Plane> Draw() const {
    std::mt19937_64 random(options_.seed);
    const std::size_t stride = (usable_.size() + kScored - 1) / kScored;
    std::optional<Plane> best;
    double best_score = options_.least_points;
    for (int draw = 0; draw < kDraws; ++draw) {
      const auto plane = ThroughThree(random);
      if (!plane) continue;
      double score = 0;
      for (std::size_t k = 0; k < usable_.size(); k += stride) {
        const double gap = Gap(*plane, usable_[k]);
        if (std::abs(gap) < threshold_mm_) score += 1;
        if (gap < -2 * threshold_mm_) score -= 2;
      }
      score *= static_cast<double>(stride);
      if (score > best_score) {
        best_score = score;
        best = plane;
      }
    }
    return best;
  }

  // Places that are flat on the plane and further than edge_mm from all that is not.
  std::vector<std::uint8_t> FlatPart(const Plane& plane) const {
    Image<double> gap(point_.size(), std::numeric_limits<double>::quiet_NaN());
    for (const std::size_t i : usable_) gap.data()[i] = Gap(plane, i);
    const Image<double> smooth = Smoothed(gap);
    std::vector<double> near;
    for (const std::size_t i : usable_) {
      if (std::abs(gap.data()[i]) < threshold_mm_) near.push_back(std::abs(smooth.data()[i]));
    }
    std::vector<std::uint8_t> flat(point_.pixel_count(), 0);
    if (near.empty()) return flat;
    const double lift_mm = std::max(kLeastLift_mm, kSigmas * 1.4826 * Median(std::move(near)));
    Image<std::uint8_t> lifted(point_.size(), 0);
    for (const std::size_t i : usable_) lifted.data()[i] = smooth.data()[i] > lift_mm ? 1 : 0;
    for (const std::size_t i : usable_) {
      const double limit = std::max(threshold_mm_, kSigmas * Sigma(plane, i));
      flat[i] = std::abs(gap.data()[i]) < limit && FarFromLifted(lifted, i) ? 1 : 0;
    }
    return flat;
  }

  double BelowShare(const Plane& plane) const {
    std::size_t below = 0;
    for (const std::size_t i : usable_) below += Gap(plane, i) < -2 * threshold_mm_ ? 1 : 0;
    return static_cast<double>(below) / static_cast<double>(usable_.size());
  }

 private:
  double Sigma(const Plane& plane, std::size_t i) const {
    return std::sqrt(std::max(0.0, plane.normal.dot(cov_.data()[i] * plane.normal)));
  }

  std::optional<Plane> ThroughThree(std::mt19937_64& random) const {
    const auto any = [&] { return usable_[random() % usable_.size()]; };
    const std::size_t a = any();
    std::size_t at[3] = {a, a, a};
    for (int k = 1; k < 3; ++k) {
      for (int attempt = 0; attempt < 30; ++attempt) {
        at[k] = any();
        if ((point_.data()[at[k]] - point_.data()[a]).norm() < kNear_mm) break;
      }
    }
    // The normal decides where the outer points lie, and they the normal.
    Plane plane{Eigen::Vector3d::Zero(), 0};
    for (int round = 0; round < 4; ++round) {
      const auto outer = [&](int k) -> Eigen::Vector3d {
        return point_.data()[at[k]] - thickness_.data()[at[k]] * plane.normal;
      };
      const Eigen::Vector3d one = outer(1) - outer(0), two = outer(2) - outer(0);
      const Eigen::Vector3d across = one.cross(two);
      const double longest = std::max({one.norm(), two.norm(), (two - one).norm()});
      if (!(across.norm() > kSlender_mm * longest) || longest > 1.5 * kNear_mm) {
        return std::nullopt;
      }
      plane.normal = across.normalized();
      if (plane.normal.dot(point_.data()[a]) > 0) plane.normal = -plane.normal;
    }
    plane.offset_mm = plane.normal.dot(point_.data()[a]) - thickness_.data()[a];
    const double roll =
        std::asin(std::clamp(axis_.direction_in_rig().dot(plane.normal), -1.0, 1.0));
    const bool below_axis = plane.normal.dot(axis_.origin_in_rig_mm()) > plane.offset_mm;
    if (std::abs(roll) > options_.max_roll_rad || !below_axis) return std::nullopt;
    return plane;
  }

  Image<double> Smoothed(const Image<double>& gap) const {
    const int half = std::max(1, static_cast<int>(std::lround(kSmoothed_mm / pitch_mm_)));
    Image<double> smooth(gap.size(), std::numeric_limits<double>::quiet_NaN());
    ForEachIndex(gap.pixel_count(), [&](std::size_t i) {
      if (!std::isfinite(gap.data()[i])) return;
      const auto row = static_cast<int>(i / static_cast<std::size_t>(gap.width()));
      const auto column = static_cast<int>(i % static_cast<std::size_t>(gap.width()));
      std::vector<double> around;
      for (int r = std::max(0, row - half); r <= std::min(gap.height() - 1, row + half); ++r) {
        for (int c = std::max(0, column - half); c <= std::min(gap.width() - 1, column + half);
             ++c) {
          if (std::isfinite(gap(r, c))) around.push_back(gap(r, c));
        }
      }
      smooth.data()[i] = Median(std::move(around));
    });
    return smooth;
  }

  bool FarFromLifted(const Image<std::uint8_t>& lifted, std::size_t i) const {
    if (lifted.data()[i] != 0) return false;
    const auto row = static_cast<int>(i / static_cast<std::size_t>(lifted.width()));
    const auto column = static_cast<int>(i % static_cast<std::size_t>(lifted.width()));
    // The grid's pitch varies with the distance: half as much again.
    const int reach = static_cast<int>(std::ceil(1.5 * options_.edge_mm / pitch_mm_));
    for (int r = std::max(0, row - reach); r <= std::min(lifted.height() - 1, row + reach); ++r) {
      for (int c = std::max(0, column - reach); c <= std::min(lifted.width() - 1, column + reach);
           ++c) {
        if (lifted(r, c) != 0 && (point_(r, c) - point_.data()[i]).norm() < options_.edge_mm) {
          return false;
        }
      }
    }
    return true;
  }

  const Image<Eigen::Vector3d>& point_;
  const Image<Eigen::Matrix3d>& cov_;
  const Image<double>& thickness_;
  const WheelAxis& axis_;
  const FlatContactOptions& options_;
  std::vector<std::size_t> usable_;
  double pitch_mm_ = 0, threshold_mm_ = 0;
};

// Of the flat part: its extent in the narrower direction, were it evenly filled, and how far a
// paraboloid through its points departs from a plane over twice their rms distance from the middle.
struct Extent {
  double narrow_mm = 0, bow_mm = 0;
};

Extent ExtentOf(const GroundPlane& plane, const Image<Eigen::Vector3d>& outer) {
  std::vector<Eigen::Vector3d> at;  // e1, e2, height
  for (std::size_t i = 0; i < outer.pixel_count(); ++i) {
    if (plane.inlier[i] == 0) continue;
    const Eigen::Vector3d q = outer.data()[i] - plane.centroid;
    at.emplace_back(plane.e1.dot(q), plane.e2.dot(q), plane.normal.dot(q));
  }
  const auto count = static_cast<Eigen::Index>(at.size());
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector3d& q : at) spread += q.head<2>() * q.head<2>().transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(spread / static_cast<double>(count));
  const Eigen::Vector2d rms = axes.eigenvalues().cwiseMax(1e-12).cwiseSqrt();
  Eigen::MatrixXd shape(count, 6);
  Eigen::VectorXd height(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const Eigen::Vector3d& q = at[static_cast<std::size_t>(k)];
    const Eigen::Vector2d s =
        (axes.eigenvectors().transpose() * q.head<2>()).cwiseQuotient(2 * rms);
    shape.row(k) << 1, s.x(), s.y(), s.x() * s.x(), s.y() * s.y(), s.x() * s.y();
    height[k] = q.z();
  }
  const Eigen::VectorXd bent = shape.colPivHouseholderQr().solve(height);
  return {std::sqrt(12.0) * rms[0], bent.tail<3>().cwiseAbs().maxCoeff()};
}

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
  if (least_points < 3) throw UsageError("A plane needs at least 3 points.");
  if (!(max_roll_rad > 0 && max_roll_rad < 1.5)) {
    throw UsageError("The wheel's axis may lean by more than 0 and less than 1.5 rad.");
  }
  if (!(max_below_share > 0 && max_below_share < 1)) {
    throw UsageError("The share of points that may lie below the ground lies between 0 and 1.");
  }
  if (!(correlation_area_points >= 1)) {
    throw UsageError("At least one point shares a point's noise: its own.");
  }
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
  const FlatSearch search(point_mm, cov_mm2, thickness_mm, axis, options);
  if (!search.HasGrid() || search.usable() < static_cast<std::size_t>(options.least_points)) {
    return No(why, fmt::format("only {} points are there", search.usable()));
  }
  const std::optional<Plane> drawn = search.Draw();
  if (!drawn) return No(why, "no part of the surface is flat");
  Plane plane = *drawn;
  FlatContact found;
  std::vector<std::uint8_t> flat;
  Image<Eigen::Vector3d> outer;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<std::uint8_t> next = search.FlatPart(plane);
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
  const Extent extent = ExtentOf(found.plane, outer);
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
