#include "fit/ground_plane.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <optional>
#include <random>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "fit/internal/plane_refinement.h"
#include "fit/internal/ransac_plane.h"

namespace plumbline {
namespace {

using internal::LocalPlane;

constexpr std::size_t kMaxSample = 20000;
constexpr double kMadToSigma = 1.4826;
constexpr double kInlierSigmas = 3.5;

std::vector<std::uint8_t> UsablePoints(std::span<const Eigen::Vector3d> points_mm,
                                       std::span<const Eigen::Matrix3d> cov_mm2) {
  if (points_mm.size() != cov_mm2.size()) {
    throw std::invalid_argument("plane fit: one covariance a point is needed");
  }
  std::vector<std::uint8_t> usable(points_mm.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, points_mm.size(), 65536),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i != range.end(); ++i) {
                        usable[i] = points_mm[i].allFinite() && cov_mm2[i].allFinite() ? 1 : 0;
                      }
                    });
  return usable;
}

// At most kMaxSample of the usable points, one from each of as many equal strata: even over the
// surface, yet out of step with the grid's rows.
std::vector<std::size_t> Subsample(std::span<const std::uint8_t> usable, std::uint64_t seed) {
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < usable.size(); ++i) {
    if (usable[i] != 0) all.push_back(i);
  }
  if (all.size() <= kMaxSample) return all;
  std::mt19937_64 random(seed);
  std::vector<std::size_t> sample(kMaxSample);
  for (std::size_t k = 0; k < kMaxSample; ++k) {
    const std::size_t begin = k * all.size() / kMaxSample;
    const std::size_t end = (k + 1) * all.size() / kMaxSample;
    sample[k] = all[begin + static_cast<std::size_t>(random() % (end - begin))];
  }
  return sample;
}

struct Spread {
  Eigen::Vector3d mean;
  Eigen::Vector3d variance;  // ascending
  Eigen::Matrix3d axes;      // columns
};

Spread SpreadOf(const internal::Moments& moments) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moments.cov);
  return {moments.mean, eigen.eigenvalues().cwiseMax(0), eigen.eigenvectors()};
}

// The length of a uniformly filled segment with this variance.
double ExtentOf(double variance) { return std::sqrt(12 * variance); }

// What RANSAC and a few rounds of orthogonal regression make of the sample at one threshold.
struct Candidate {
  Eigen::Vector3d normal, centroid;
  double inlier_fraction = 0;
  double sigma_mm = 0;  // robust scatter of the inliers
};

std::optional<Candidate> FindCandidate(std::span<const Eigen::Vector3d> sample, double threshold_mm,
                                       std::uint64_t seed) {
  const auto plane = internal::RansacPlane(sample, threshold_mm, seed);
  if (!plane) return std::nullopt;
  Candidate candidate;
  candidate.normal = plane->normal;
  candidate.centroid = plane->offset * plane->normal;
  std::vector<std::uint8_t> use(sample.size());
  std::vector<double> distances;
  for (int round = 0; round < 3; ++round) {
    distances.clear();
    for (std::size_t i = 0; i < sample.size(); ++i) {
      const double d = std::abs(candidate.normal.dot(sample[i] - candidate.centroid));
      use[i] = d <= threshold_mm ? 1 : 0;
      if (use[i] != 0) distances.push_back(d);
    }
    if (distances.size() < 3 || round == 2) break;
    const Spread spread = SpreadOf(internal::PointMoments(sample, use));
    candidate.normal = spread.axes.col(0);
    candidate.centroid = spread.mean;
  }
  if (distances.size() < 3) return std::nullopt;
  candidate.inlier_fraction =
      static_cast<double>(distances.size()) / static_cast<double>(sample.size());
  candidate.sigma_mm = kMadToSigma * Median(std::move(distances));
  return candidate;
}

// How far the surface departs from the plane as a paraboloid, as a share of its extent, and the
// share of the points' scatter that this explains.
struct Bow {
  double share_of_extent = 0;
  double explained = 0;
};

Bow MeasureBow(std::span<const Eigen::Vector3d> sample, const LocalPlane& plane,
               double threshold_mm) {
  std::vector<Eigen::Vector3d> inliers;  // in the plane's basis
  for (const Eigen::Vector3d& point : sample) {
    const Eigen::Vector3d q = point - plane.centroid;
    if (std::abs(plane.normal.dot(q)) > threshold_mm) continue;
    inliers.emplace_back(plane.e1.dot(q), plane.e2.dot(q), plane.normal.dot(q));
  }
  const auto n = static_cast<Eigen::Index>(inliers.size());
  if (n < 12) return {};
  double radius = 0;
  for (const Eigen::Vector3d& q : inliers) radius = std::max(radius, q.head<2>().norm());
  Eigen::MatrixXd A(n, 6);
  Eigen::VectorXd z(n);
  double sum_x2 = 0;
  double sum_y2 = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d& q = inliers[static_cast<std::size_t>(i)];
    const double x = q.x() / radius;
    const double y = q.y() / radius;
    A.row(i) << 1, x, y, x * x, x * y, y * y;
    z[i] = q.z();
    sum_x2 += q.x() * q.x();
    sum_y2 += q.y() * q.y();
  }
  const auto residual = [&](Eigen::Index columns) {
    const Eigen::VectorXd c = A.leftCols(columns).colPivHouseholderQr().solve(z);
    return (z - A.leftCols(columns) * c).squaredNorm();
  };
  const double flat = residual(3) / static_cast<double>(n - 3);
  const double curved = residual(6) / static_cast<double>(n - 6);
  if (!(flat > 0) || curved >= flat) return {};
  // A parabola's range is sqrt(45 / 4) times its standard deviation.
  const double bow_mm = std::sqrt(45.0 / 4.0 * (flat - curved));
  const double extent_mm = ExtentOf(std::max(sum_x2, sum_y2) / static_cast<double>(n));
  return {bow_mm / extent_mm, 1 - curved / flat};
}

bool IsCurved(const Bow& bow, double max_bow) {
  return bow.share_of_extent > max_bow && bow.explained > 0.3;
}

[[noreturn]] void RefuseCurved(const Bow& bow, double max_bow) {
  throw InputError(fmt::format(
      "No ground plane: the surface is curved, it bows by {:.1f} % of its extent and {:.1f} % is "
      "allowed; choose a flatter part with a region of interest or a mask.",
      100 * bow.share_of_extent, 100 * max_bow));
}

// Tries thresholds from the points' own sigma upwards until the scatter of the inliers is that of a
// plane with noise, not that of a slab cut out of something else.
struct Start {
  Candidate candidate;
  double threshold_mm = 0;
};

Start FindStart(std::span<const Eigen::Vector3d> sample, std::span<const Eigen::Matrix3d> cov,
                const GroundPlaneOptions& options) {
  const std::vector<std::uint8_t> everything(sample.size(), 1);
  const double extent_mm =
      ExtentOf(SpreadOf(internal::PointMoments(sample, everything)).variance[2]);
  double first_mm = options.inlier_threshold_mm;
  if (first_mm == 0) {
    std::vector<double> sigmas;
    for (const Eigen::Matrix3d& c : cov) {
      sigmas.push_back(std::sqrt(std::max(0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>()
                                                   .computeDirect(c, Eigen::EigenvaluesOnly)
                                                   .eigenvalues()[2])));
    }
    first_mm = std::max(3 * Median(std::move(sigmas)), 1e-7 * extent_mm);
  }
  const double last_mm =
      options.inlier_threshold_mm > 0 ? first_mm : std::max(first_mm, 0.05 * extent_mm);
  std::optional<Candidate> best;
  double best_threshold_mm = 0;
  for (double threshold_mm = first_mm; threshold_mm <= last_mm; threshold_mm *= 2) {
    auto candidate = FindCandidate(sample, threshold_mm, options.seed);
    if (!candidate) continue;
    best = candidate;
    best_threshold_mm = threshold_mm;
    if (candidate->inlier_fraction < options.min_inlier_fraction) continue;
    if (options.inlier_threshold_mm > 0) return {*candidate, threshold_mm};
    // For a Gaussian cut at 3 sigma the two sides are equal; for a uniform slab 2.2 to 1.
    if (3 * candidate->sigma_mm > 1.3 * threshold_mm) continue;
    return {*candidate, std::max(kInlierSigmas * candidate->sigma_mm, 1e-7 * extent_mm)};
  }
  if (!best) {
    throw InputError(
        "No ground plane: the points lie along a line or in one place, so they span no plane.");
  }
  const LocalPlane plane = internal::MakeLocalPlane(best->normal, best->centroid);
  const Bow bow = MeasureBow(sample, plane, best_threshold_mm);
  if (IsCurved(bow, options.max_bow)) RefuseCurved(bow, options.max_bow);
  throw InputError(fmt::format(
      "No ground plane: at most {:.0f} % of the points lie within {:.3g} mm of one plane and "
      "{:.0f} % are needed; choose the ground with a region of interest or a mask.",
      100 * best->inlier_fraction, best_threshold_mm, 100 * options.min_inlier_fraction));
}

// Marks the usable points within the threshold; returns how many there are and whether the marks
// changed.
std::size_t MarkInliers(std::span<const Eigen::Vector3d> points_mm,
                        std::span<const std::uint8_t> usable, const LocalPlane& plane,
                        double threshold_mm, std::vector<std::uint8_t>& inlier, bool& changed) {
  changed = false;
  std::size_t count = 0;
  for (std::size_t i = 0; i < points_mm.size(); ++i) {
    std::uint8_t mark = 0;
    if (usable[i] != 0) {
      const double d = plane.normal.dot(points_mm[i] - plane.centroid);
      mark = std::abs(d) <= threshold_mm ? 1 : 0;
    }
    changed = changed || mark != inlier[i];
    inlier[i] = mark;
    count += mark;
  }
  return count;
}

void RefuseLine(const Spread& spread) {
  // A plane needs two directions in which the points spread by more than they scatter across it.
  if (spread.variance[1] > 25 * spread.variance[0] &&
      spread.variance[1] > 1e-10 * spread.variance[2]) {
    return;
  }
  throw InputError(fmt::format(
      "No ground plane: the points lie along a line ({:.3g} mm long, {:.2g} mm wide), so the plane "
      "could turn about it; choose a wider region.",
      ExtentOf(spread.variance[2]), ExtentOf(spread.variance[1])));
}

GroundPlane Finish(const internal::PlaneSolution& solution, std::vector<std::uint8_t> inlier,
                   double correlation_area_points) {
  GroundPlane plane;
  LocalPlane local = solution.plane;
  if (local.normal.dot(local.centroid) > 0) {  // the rig's origin must be on the normal's side
    local.normal = -local.normal;
    local.e2 = -local.e2;
  }
  plane.normal = local.normal;
  plane.centroid = local.centroid;
  plane.offset_mm = local.normal.dot(local.centroid);
  plane.e1 = local.e1;
  plane.e2 = local.e2;
  // Turning normal and e2 over: a turn about e2 and a shift along the normal change sign.
  const Eigen::Vector3d sign = (local.normal.dot(solution.plane.normal) > 0)
                                   ? Eigen::Vector3d(1, 1, 1)
                                   : Eigen::Vector3d(1, -1, -1);
  const double factor =
      std::max(1.0, solution.scatter_ratio * solution.scatter_ratio) * correlation_area_points;
  plane.cov = factor * sign.asDiagonal() * solution.inverse_normal_matrix * sign.asDiagonal();
  plane.scatter_ratio = solution.scatter_ratio;
  plane.rms_mm = solution.rms_mm;
  plane.inlier = std::move(inlier);
  return plane;
}

}  // namespace

void GroundPlaneOptions::Check() const {
  if (!(inlier_threshold_mm >= 0) || !std::isfinite(inlier_threshold_mm)) {
    throw UsageError("The plane's inlier threshold must be 0 (automatic) or positive, in mm.");
  }
  if (!(min_inlier_fraction > 0) || !(min_inlier_fraction <= 1)) {
    throw UsageError("The plane's smallest inlier fraction must be above 0 and at most 1.");
  }
  if (min_points < 4) {
    throw UsageError("The plane's smallest number of points must be at least 4.");
  }
  if (!(max_bow > 0)) throw UsageError("The bow allowed of a plane must be positive.");
  if (!(correlation_area_points >= 1) || !std::isfinite(correlation_area_points)) {
    throw UsageError("The number of points that share one noise must be at least 1.");
  }
}

GroundPlane FitGroundPlane(std::span<const Eigen::Vector3d> points_mm,
                           std::span<const Eigen::Matrix3d> cov_mm2,
                           const GroundPlaneOptions& options) {
  options.Check();
  const std::vector<std::uint8_t> usable = UsablePoints(points_mm, cov_mm2);
  const auto usable_count =
      static_cast<std::size_t>(std::count(usable.begin(), usable.end(), std::uint8_t{1}));
  if (usable_count < static_cast<std::size_t>(options.min_points)) {
    throw InputError(fmt::format("No ground plane: {} points are valid and {} are needed.",
                                 usable_count, options.min_points));
  }
  std::vector<Eigen::Vector3d> sample;
  std::vector<Eigen::Matrix3d> sample_cov;
  for (const std::size_t i : Subsample(usable, options.seed)) {
    sample.push_back(points_mm[i]);
    sample_cov.push_back(cov_mm2[i]);
  }
  const Start start = FindStart(sample, sample_cov, options);

  LocalPlane plane = internal::MakeLocalPlane(start.candidate.normal, start.candidate.centroid);
  std::vector<std::uint8_t> inlier(points_mm.size(), 0);
  internal::PlaneSolution solution;
  std::size_t count = 0;
  double fraction = 0;
  for (int round = 0; round < 6; ++round) {
    bool changed = false;
    count = MarkInliers(points_mm, usable, plane, start.threshold_mm, inlier, changed);
    fraction = static_cast<double>(count) / static_cast<double>(usable_count);
    if (fraction < options.min_inlier_fraction ||
        count < static_cast<std::size_t>(options.min_points)) {
      throw InputError(fmt::format(
          "No ground plane: {} of {} points lie within {:.3g} mm of one plane and {:.0f} % are "
          "needed, at least {}.",
          count, usable_count, start.threshold_mm, 100 * options.min_inlier_fraction,
          options.min_points));
    }
    if (!changed) break;
    const Spread spread = SpreadOf(internal::PointMoments(points_mm, inlier));
    RefuseLine(spread);
    plane = internal::MakeLocalPlane(plane.normal, spread.mean);
    solution = internal::RefinePlane(points_mm, cov_mm2, inlier, plane);
    plane = solution.plane;
  }
  const Bow bow = MeasureBow(sample, plane, start.threshold_mm);
  if (IsCurved(bow, options.max_bow)) RefuseCurved(bow, options.max_bow);

  GroundPlane result = Finish(solution, std::move(inlier), options.correlation_area_points);
  result.inlier_fraction = fraction;
  result.inlier_threshold_mm = start.threshold_mm;
  return result;
}

GroundPlane RefitPlane(std::span<const Eigen::Vector3d> points_mm,
                       std::span<const Eigen::Matrix3d> cov_mm2,
                       std::span<const std::uint8_t> inlier, double correlation_area_points) {
  if (inlier.size() != points_mm.size()) {
    throw std::invalid_argument("plane fit: one inlier mark a point is needed");
  }
  std::vector<std::uint8_t> use = UsablePoints(points_mm, cov_mm2);
  std::size_t usable_count = 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < use.size(); ++i) {
    usable_count += use[i];
    use[i] = use[i] != 0 && inlier[i] != 0 ? 1 : 0;
    count += use[i];
  }
  if (count < 3) {
    throw InputError(fmt::format("No plane: {} of the given inliers are valid.", count));
  }
  const Spread spread = SpreadOf(internal::PointMoments(points_mm, use));
  const auto solution = internal::RefinePlane(
      points_mm, cov_mm2, use, internal::MakeLocalPlane(spread.axes.col(0), spread.mean));
  GroundPlane plane = Finish(solution, std::move(use), correlation_area_points);
  plane.inlier_fraction = static_cast<double>(count) / static_cast<double>(usable_count);
  return plane;
}

Eigen::Vector3d PlaneDifference(const GroundPlane& reference, const GroundPlane& plane) {
  // The turn that takes one normal to the other: its axis is their cross product.
  const Eigen::Vector3d cross = reference.normal.cross(plane.normal);
  const double sine = cross.norm();
  const double cosine = reference.normal.dot(plane.normal);
  const Eigen::Vector3d turn = sine > 0 ? cross * (std::atan2(sine, cosine) / sine) : cross;
  // The other plane's height above the reference's centroid, along the reference's normal.
  const double shift = (plane.offset_mm - plane.normal.dot(reference.centroid)) / cosine;
  return {reference.e1.dot(turn), reference.e2.dot(turn), shift};
}

Rigid3 GroundFromRig(const GroundPlane& plane, const Eigen::Vector3d& travel_direction_in_rig,
                     const Eigen::Vector3d& origin_above) {
  const Eigen::Vector3d& z = plane.normal;
  const auto projected = [&](const Eigen::Vector3d& v) -> Eigen::Vector3d {
    return v - v.dot(z) * z;
  };
  Eigen::Vector3d x;
  if (travel_direction_in_rig.norm() > 0) {
    x = projected(travel_direction_in_rig.normalized());
    if (x.norm() < 1e-3) {
      throw InputError(
          "The direction of travel is along the ground's normal, so it gives no x axis.");
    }
  } else {
    x = projected(Eigen::Vector3d::UnitX());
    if (x.norm() < 1e-3) x = projected(Eigen::Vector3d::UnitY());
  }
  x.normalize();
  Rigid3 ground_from_rig;
  ground_from_rig.rotation.row(0) = x;
  ground_from_rig.rotation.row(1) = z.cross(x);
  ground_from_rig.rotation.row(2) = z;
  const Eigen::Vector3d origin = origin_above - plane.SignedDistance(origin_above) * z;
  ground_from_rig.translation_mm = -(ground_from_rig.rotation * origin);
  return ground_from_rig;
}

}  // namespace plumbline
