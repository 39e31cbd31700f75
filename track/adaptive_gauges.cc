#include "track/adaptive_gauges.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <utility>

#include "calib/error.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

// Of a covariance's upper triangle, row by row.
Eigen::Vector3f VariancesOf(const Eigen::Matrix<float, 6, 1>& cov) {
  return {cov[0], cov[3], cov[5]};
}

std::vector<int> WindowsOf(const AdaptiveGaugesOptions& options) {
  const int largest = options.gauge.window_points;
  std::vector<int> windows;
  if (options.smallest_window_points > 0) {
    for (int w = options.smallest_window_points; w < largest;
         w = std::max(w + 2, (4 * w + 2) / 3 | 1)) {
      windows.push_back(w);
    }
  }
  windows.push_back(largest);
  return windows;
}

bool Agree(const SurfaceStrain& small, const SurfaceStrain& large, std::size_t i, double sigmas) {
  constexpr float kLeastShare = 0.1F;
  const Eigen::Vector3f by_small = VariancesOf(small.cov_strain.data()[i]);
  const Eigen::Vector3f by_large = VariancesOf(large.cov_strain.data()[i]);
  const Eigen::Vector3f variance = (by_small - by_large).cwiseMax(kLeastShare * by_small);
  const Eigen::Vector3f off = small.strain.data()[i] - large.strain.data()[i];
  const auto limit = static_cast<float>(sigmas * sigmas);
  return (off.cwiseAbs2().array() <= limit * variance.array()).all();
}

// Which gauge is taken at a point, and which one tells what its polynomial leaves out.
struct Choice {
  std::optional<std::size_t> taken, other;
};

Choice ChooseAt(const std::vector<SurfaceStrain>& by_size, std::size_t i, double sigmas) {
  Choice choice;
  std::vector<std::size_t> smaller;
  for (std::size_t k = 0; k < by_size.size(); ++k) {
    if (by_size[k].status.data()[i] != Status::kOk) continue;
    const bool agrees = std::all_of(smaller.begin(), smaller.end(), [&](std::size_t j) {
      return Agree(by_size[j], by_size[k], i, sigmas);
    });
    if (!agrees) {
      choice.other = k;
      break;
    }
    choice.other = choice.taken;
    choice.taken = k;
    smaller.push_back(k);
  }
  return choice;
}

void CopyPoint(const SurfaceStrain& from, std::size_t i, SurfaceStrain& to) {
  const auto copy = [&](auto SurfaceStrain::*... images) {
    (((to.*images).data()[i] = (from.*images).data()[i]), ...);
  };
  using S = SurfaceStrain;
  copy(&S::strain, &S::cov_strain, &S::sigma_calibration, &S::principal, &S::sigma_principal_random,
       &S::sigma_principal_calibration, &S::angle_rad, &S::sigma_angle_random_rad,
       &S::sigma_angle_calibration_rad, &S::max_shear, &S::sigma_max_shear_random,
       &S::sigma_max_shear_calibration, &S::von_mises, &S::sigma_von_mises_random,
       &S::sigma_von_mises_calibration, &S::points, &S::status);
}

}  // namespace

void AdaptiveGaugesOptions::Check() const {
  gauge.Check();
  if (smallest_window_points == 0) return;
  SurfaceStrainOptions smallest = gauge;
  smallest.window_points = smallest_window_points;
  smallest.Check();
  if (smallest_window_points > gauge.window_points)
    throw UsageError(
        fmt::format("the smallest window of a strain gauge must not be larger than the largest of "
                    "{} points, but is {}",
                    gauge.window_points, smallest_window_points));
  if (!(agreement_sigmas > 0 && std::isfinite(agreement_sigmas)))
    throw UsageError("strain gauges must agree to a positive number of sigmas");
}

AdaptiveGauges::AdaptiveGauges(const SurfaceState& reference, const Image<Eigen::Vector3f>& cov_px2,
                               const NeighbourCorrelation& neighbours, int step_px, int subset_px,
                               const AdaptiveGaugesOptions& options)
    : options_(options) {
  options_.Check();
  SurfaceStrainOptions gauge = options_.gauge;
  for (const int window : WindowsOf(options_)) {
    gauge.window_points = window;
    gauges_.emplace_back(reference, cov_px2, neighbours, step_px, subset_px, gauge);
  }
}

AdaptiveStrain AdaptiveGauges::Strain(const SurfaceState& now, const Image<Status>& status) const {
  std::vector<SurfaceStrain> by_size;
  for (const SurfaceGauges& gauges : gauges_) by_size.push_back(gauges.Strain(now, status));
  AdaptiveStrain out;
  if (by_size.size() == 1) {
    out.strain = std::move(by_size[0]);
    return out;
  }
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  const ImageSize size = status.size();
  out.window_points = Image<float>(size, kNan);
  out.sigma_model = Image<Eigen::Vector3f>(size, Eigen::Vector3f::Constant(kNan));
  out.strain = by_size.back();
  ForEachIndex(status.pixel_count(), [&](std::size_t i) {
    const Choice choice = ChooseAt(by_size, i, options_.agreement_sigmas);
    CopyPoint(by_size[choice.taken.value_or(0)], i, out.strain);
    if (!choice.taken) return;
    const SurfaceStrain& taken = by_size[*choice.taken];
    out.window_points.data()[i] = static_cast<float>(taken.window_points);
    if (!choice.other) return;
    out.sigma_model.data()[i] =
        (by_size[*choice.other].strain.data()[i] - taken.strain.data()[i]).cwiseAbs();
  });
  return out;
}

}  // namespace plumbline
