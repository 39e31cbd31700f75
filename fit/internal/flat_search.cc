#include "fit/internal/flat_search.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/parallel.h"

namespace plumbline::internal {
namespace {

constexpr int kDraws = 1200;
constexpr std::size_t kScored = 1500;  // points that a drawn plane is held against
constexpr double kNear_mm = 70;        // a drawn triangle is no larger
constexpr double kSlender_mm = 15;     // nor lower
constexpr double kLeastThreshold_mm = 0.06;
constexpr double kSmoothed_mm = 6;  // gaps are told as medians over such a half width
constexpr double kLeastLift_mm = 0.03;
constexpr double kSigmas = 3.5;

}  // namespace

void CheckFlatSearch(int least_points, double max_roll_rad, double max_below_share,
                     double correlation_area_points) {
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

FlatSearch::FlatSearch(const Image<Eigen::Vector3d>& point, const Image<Eigen::Matrix3d>& cov,
                       const Image<double>& thickness, const WheelAxis& axis)
    : point_(point), cov_(cov), thickness_(thickness), axis_(axis) {
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

std::optional<FlatPlane> FlatSearch::DrawPlane(const Draw& draw) const {
  std::mt19937_64 random(draw.seed);
  const std::size_t stride = (usable_.size() + kScored - 1) / kScored;
  std::optional<FlatPlane> best;
  double best_score = draw.least_score;
  for (int k = 0; k < kDraws; ++k) {
    const auto plane = ThroughThree(draw.max_roll_rad, random);
    if (!plane) continue;
    double score = 0;
    for (std::size_t at = 0; at < usable_.size(); at += stride) {
      const double gap = Gap(*plane, usable_[at]);
      if (std::abs(gap) < threshold_mm_) score += 1;
      if (gap < -2 * threshold_mm_) score -= draw.below_weight;
    }
    score *= static_cast<double>(stride);
    if (score > best_score) {
      best_score = score;
      best = plane;
    }
  }
  return best;
}

std::vector<std::uint8_t> FlatSearch::FlatPart(const FlatPlane& plane, double edge_mm,
                                               Off off) const {
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
  Image<std::uint8_t> lifted =
      off == Off::kAbove ? Image<std::uint8_t>(point_.size(), 0) : Unseen();
  for (const std::size_t i : usable_) {
    const double from_plane = off == Off::kAbove ? smooth.data()[i] : std::abs(smooth.data()[i]);
    if (from_plane > lift_mm) lifted.data()[i] = 1;
  }
  for (const std::size_t i : usable_) {
    const double limit = std::max(threshold_mm_, kSigmas * Sigma(plane, i));
    flat[i] = std::abs(gap.data()[i]) < limit && FarFrom(lifted, i, edge_mm) ? 1 : 0;
  }
  return flat;
}

double FlatSearch::BelowShare(const FlatPlane& plane) const {
  std::size_t below = 0;
  for (const std::size_t i : usable_) below += Gap(plane, i) < -2 * threshold_mm_ ? 1 : 0;
  return static_cast<double>(below) / static_cast<double>(usable_.size());
}

double FlatSearch::Sigma(const FlatPlane& plane, std::size_t i) const {
  return std::sqrt(std::max(0.0, plane.normal.dot(cov_.data()[i] * plane.normal)));
}

std::optional<FlatPlane> FlatSearch::ThroughThree(double max_roll_rad,
                                                  std::mt19937_64& random) const {
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
  FlatPlane plane{Eigen::Vector3d::Zero(), 0};
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
  const double roll = std::asin(std::clamp(axis_.direction_in_rig().dot(plane.normal), -1.0, 1.0));
  const bool below_axis = plane.normal.dot(axis_.origin_in_rig_mm()) > plane.offset_mm;
  if (std::abs(roll) > max_roll_rad || !below_axis) return std::nullopt;
  return plane;
}

Image<double> FlatSearch::Smoothed(const Image<double>& gap) const {
  const int half = std::max(1, static_cast<int>(std::lround(kSmoothed_mm / pitch_mm_)));
  Image<double> smooth(gap.size(), std::numeric_limits<double>::quiet_NaN());
  ForEachIndex(gap.pixel_count(), [&](std::size_t i) {
    if (!std::isfinite(gap.data()[i])) return;
    const auto row = static_cast<int>(i / static_cast<std::size_t>(gap.width()));
    const auto column = static_cast<int>(i % static_cast<std::size_t>(gap.width()));
    std::vector<double> around;
    for (int r = std::max(0, row - half); r <= std::min(gap.height() - 1, row + half); ++r) {
      for (int c = std::max(0, column - half); c <= std::min(gap.width() - 1, column + half); ++c) {
        if (std::isfinite(gap(r, c))) around.push_back(gap(r, c));
      }
    }
    smooth.data()[i] = Median(std::move(around));
  });
  return smooth;
}

// Where most of the places around have no point; not where one alone is missing.
Image<std::uint8_t> FlatSearch::Unseen() const {
  Image<std::uint8_t> seen(point_.size(), 0), unseen(point_.size(), 0);
  for (const std::size_t i : usable_) seen.data()[i] = 1;
  for (int row = 0; row < seen.height(); ++row) {
    for (int column = 0; column < seen.width(); ++column) {
      if (seen(row, column) != 0) continue;
      int all = 0, missing = 0;
      for (int r = std::max(0, row - 2); r <= std::min(seen.height() - 1, row + 2); ++r) {
        for (int c = std::max(0, column - 2); c <= std::min(seen.width() - 1, column + 2); ++c) {
          ++all;
          missing += seen(r, c) == 0 ? 1 : 0;
        }
      }
      unseen(row, column) = 2 * missing > all ? 1 : 0;
    }
  }
  return unseen;
}

bool FlatSearch::FarFrom(const Image<std::uint8_t>& marked, std::size_t i, double edge_mm) const {
  if (marked.data()[i] != 0) return false;
  const auto row = static_cast<int>(i / static_cast<std::size_t>(marked.width()));
  const auto column = static_cast<int>(i % static_cast<std::size_t>(marked.width()));
  // The grid's pitch varies with the distance: half as much again.
  const int reach = static_cast<int>(std::ceil(1.5 * edge_mm / pitch_mm_));
  for (int r = std::max(0, row - reach); r <= std::min(marked.height() - 1, row + reach); ++r) {
    for (int c = std::max(0, column - reach); c <= std::min(marked.width() - 1, column + reach);
         ++c) {
      if (marked(r, c) == 0) continue;
      const double away_mm = point_(r, c).allFinite() ? (point_(r, c) - point_.data()[i]).norm()
                                                      : pitch_mm_ * std::hypot(r - row, c - column);
      if (away_mm < edge_mm) return false;
    }
  }
  return true;
}

FlatExtent ExtentOf(const GroundPlane& plane, const Image<Eigen::Vector3d>& outer) {
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
  return {std::sqrt(12.0) * rms[0], std::sqrt(12.0) * rms[1], bent.tail<3>().cwiseAbs().maxCoeff(),
          std::abs(bent[3])};
}

}  // namespace plumbline::internal
