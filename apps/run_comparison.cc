#include "apps/run_comparison.h"

#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "calib/error.h"
#include "calib/median.h"
#include "io/series_points.h"

namespace plumbline {
namespace {

constexpr double kNone = HeightComparison::kNone;

// The places of one line alone.
GroundGrid AlongSection(const GroundGrid& all, const CutPlane& section) {
  GroundGrid grid = all;
  const double at_mm = section.offset_mm;
  if (std::abs(section.normal.x()) > 0) {
    grid.first_mm.x() = at_mm * section.normal.x();
    grid.size.width = std::min(1, all.size.width);
  } else {
    grid.first_mm.y() = at_mm * section.normal.y();
    grid.size.height = std::min(1, all.size.height);
  }
  return grid;
}

struct Differences {
  std::vector<Eigen::Vector2d> at_mm;
  std::vector<double> value_mm, random_mm, calibration_mm;
};

Differences Known(const HeightDifference& difference, const GroundGrid& grid) {
  Differences known;
  for (int r = 0; r < grid.size.height; ++r) {
    for (int c = 0; c < grid.size.width; ++c) {
      if (!std::isfinite(difference.value_mm(r, c))) continue;
      known.at_mm.push_back(grid.At(r, c));
      known.value_mm.push_back(difference.value_mm(r, c));
      known.random_mm.push_back(difference.sigma_random_mm(r, c));
      known.calibration_mm.push_back(difference.sigma_calibration_mm(r, c));
    }
  }
  return known;
}

double MedianSize(const std::vector<double>& values, double from) {
  std::vector<double> sizes;
  sizes.reserve(values.size());
  for (const double value : values) sizes.push_back(std::abs(value - from));
  return Median(std::move(sizes));
}

// By least squares: slopes along x and y (0 along an axis that `slopes` leaves out), and the height
// at the origin. Nothing where the places do not tell.
std::optional<Eigen::Vector3d> PlaneThrough(const Differences& known,
                                            const std::array<bool, 2>& slopes) {
  constexpr double kMedians = 6;
  const double middle = Median(known.value_mm);
  const double most = kMedians * MedianSize(known.value_mm, middle);
  std::vector<std::size_t> used;
  for (std::size_t i = 0; i < known.value_mm.size(); ++i) {
    if (std::abs(known.value_mm[i] - middle) <= most) used.push_back(i);
  }
  const Eigen::Index columns = 1 + (slopes[0] ? 1 : 0) + (slopes[1] ? 1 : 0);
  Eigen::MatrixXd A(static_cast<Eigen::Index>(used.size()), columns);
  Eigen::VectorXd b(A.rows());
  for (Eigen::Index i = 0; i < A.rows(); ++i) {
    const std::size_t k = used[static_cast<std::size_t>(i)];
    Eigen::Index column = 0;
    for (Eigen::Index axis = 0; axis < 2; ++axis) {
      if (slopes[static_cast<std::size_t>(axis)]) A(i, column++) = known.at_mm[k][axis];
    }
    A(i, column) = 1;
    b[i] = known.value_mm[k];
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
  if (qr.rank() < columns) return std::nullopt;
  const Eigen::VectorXd x = qr.solve(b);
  return Eigen::Vector3d(slopes[0] ? x[0] : 0, slopes[1] ? x[slopes[0] ? 1 : 0] : 0,
                         x[columns - 1]);
}

// Of slopes along x and y and the height at the origin, both frames' ground planes together.
Eigen::Vector3d SigmaOfPlanes(const GroundRecord& run, const GroundRecord& other,
                              Eigen::Matrix3d GroundRecord::*cov) {
  const Eigen::Matrix3d a = HeightErrorsOf(run, run.*cov), b = HeightErrorsOf(other, other.*cov);
  return (a.rowwise().squaredNorm() + b.rowwise().squaredNorm()).cwiseSqrt();
}

void SetPlane(const SeriesFrame& run, const SeriesFrame& other, const Differences& known,
              const std::array<bool, 2>& slopes, HeightComparison* out) {
  const auto plane = PlaneThrough(known, slopes);
  if (!plane) return;
  const Eigen::Vector3d random = SigmaOfPlanes(run.ground, other.ground, &GroundRecord::cov_random);
  const Eigen::Vector3d calibration =
      SigmaOfPlanes(run.ground, other.ground, &GroundRecord::cov_calibration);
  out->offset_mm = (*plane)[2];
  out->sigma_random_offset_mm = random[2];
  out->sigma_calibration_offset_mm = calibration[2];
  // A turn about x raises where y is positive, one about y lowers where x is.
  if (slopes[1]) {
    out->tilt_rad[0] = std::atan((*plane)[1]);
    out->sigma_random_tilt_rad[0] = random[1];
    out->sigma_calibration_tilt_rad[0] = calibration[1];
  }
  if (slopes[0]) {
    out->tilt_rad[1] = -std::atan((*plane)[0]);
    out->sigma_random_tilt_rad[1] = random[0];
    out->sigma_calibration_tilt_rad[1] = calibration[0];
  }
  double squares = 0;
  for (std::size_t i = 0; i < known.value_mm.size(); ++i) {
    const double on_plane = plane->head<2>().dot(known.at_mm[i]) + (*plane)[2];
    squares += std::pow(known.value_mm[i] - on_plane, 2);
  }
  out->rms_from_plane_mm = std::sqrt(squares / static_cast<double>(known.value_mm.size()));
}

}  // namespace

std::vector<FramePair> PairByIndex(std::span<const std::int64_t> run_indices,
                                   std::span<const std::int64_t> other_indices) {
  std::map<std::int64_t, std::int64_t> place;
  for (std::size_t k = 0; k < other_indices.size(); ++k) {
    place.emplace(other_indices[k], static_cast<std::int64_t>(k));
  }
  std::vector<FramePair> pairs;
  for (std::size_t i = 0; i < run_indices.size(); ++i) {
    const auto found = place.find(run_indices[i]);
    if (found == place.end()) continue;
    pairs.push_back({static_cast<std::int64_t>(i), found->second, kNone});
  }
  return pairs;
}

std::vector<FramePair> PairByTravel(std::span<const double> run_travel_mm,
                                    std::span<const double> other_travel_mm, double shift_mm,
                                    double most_apart_mm) {
  std::vector<FramePair> pairs;
  for (std::size_t i = 0; i < run_travel_mm.size(); ++i) {
    std::optional<FramePair> nearest;
    for (std::size_t k = 0; k < other_travel_mm.size(); ++k) {
      const double ahead_mm = other_travel_mm[k] - shift_mm - run_travel_mm[i];
      if (!(std::abs(ahead_mm) <= most_apart_mm)) continue;
      if (nearest && std::abs(nearest->ahead_mm) <= std::abs(ahead_mm)) continue;
      nearest = FramePair{static_cast<std::int64_t>(i), static_cast<std::int64_t>(k), ahead_mm};
    }
    if (nearest) pairs.push_back(*nearest);
  }
  return pairs;
}

void RunComparisonOptions::Check() const {
  if (!(step_mm > 0)) throw UsageError("The places of a comparison are above 0 mm apart.");
  if (!section) return;
  section->Check();
  if (std::max(std::abs(section->normal.x()), std::abs(section->normal.y())) < 1) {
    throw UsageError("Runs are compared along a section x = a or y = b.");
  }
}

HeightComparison CompareFrames(const SeriesFrame& run, const NeighbourCorrelation& run_neighbours,
                               const SeriesFrame& other,
                               const NeighbourCorrelation& other_neighbours,
                               const RunComparisonOptions& options) {
  options.Check();
  const SurfacePoints here = PointsOf(run);
  SurfacePoints there = PointsOf(other);
  if (run.wheel.found && other.wheel.found) {
    // Where along the axis a ground frame begins depends on where the camera stands.
    Eigen::Vector3d shift = run.wheel.centre_mm - other.wheel.centre_mm;
    shift.z() = 0;
    for (Eigen::Vector3d& p : there.point_mm.values()) p += shift;
  }
  GroundGrid grid = GridAround(here, options.step_mm);
  std::array<bool, 2> slopes = {true, true};
  if (options.section) {
    grid = AlongSection(grid, *options.section);
    slopes[std::abs(options.section->normal.x()) > 0 ? 0 : 1] = false;
  }
  HeightComparison out;
  out.run = HeightsOf(here, grid, run_neighbours);
  out.other = HeightsOf(there, grid, other_neighbours);
  out.difference = CompareHeights(out.run, out.other, false);
  const Differences known = Known(out.difference, grid);
  if (known.value_mm.empty()) {
    out.difference.mean_mm = out.difference.rms_mm = kNone;
    return out;
  }
  const auto count = static_cast<double>(known.value_mm.size());
  out.median_mm = MedianSize(known.value_mm, 0);
  out.median_sigma_random_mm = Median(known.random_mm);
  double within = 0;
  bool calibrated = true;
  for (std::size_t i = 0; i < known.value_mm.size(); ++i) {
    const double common = known.calibration_mm[i];
    calibrated = calibrated && std::isfinite(common);
    const double sigma = std::hypot(known.random_mm[i], std::isfinite(common) ? common : 0);
    within += std::abs(known.value_mm[i]) <= 2 * sigma ? 1 : 0;
  }
  if (calibrated) out.median_sigma_calibration_mm = Median(known.calibration_mm);
  out.within_two_sigma = within / count;
  if (options.section) {
    out.length_mm = count * options.step_mm;
  } else {
    out.area_mm2 = count * options.step_mm * options.step_mm;
  }
  SetPlane(run, other, known, slopes, &out);
  return out;
}

}  // namespace plumbline
