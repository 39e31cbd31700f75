#include "track/adaptive_gauges.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>

#include "calib/error.h"
#include "calib/median.h"
#include "calib/parallel.h"

namespace plumbline {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

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

using Squares = Eigen::Array3f;  // by component

// How far gauges of two sizes say otherwise at each point: squared, over the variance that is
// claimed for it. NaN where not both are there.
Image<Squares> Disagreement(const SurfaceStrain& small, const SurfaceStrain& large) {
  constexpr float kLeastShare = 0.1F;
  Image<Squares> out(small.size(), Squares::Constant(kNan));
  ForEachIndex(out.pixel_count(), [&](std::size_t i) {
    if (small.status.data()[i] != Status::kOk || large.status.data()[i] != Status::kOk) return;
    const Eigen::Vector3f by_small = VariancesOf(small.cov_strain.data()[i]);
    const Eigen::Vector3f by_large = VariancesOf(large.cov_strain.data()[i]);
    const Eigen::Vector3f variance = (by_small - by_large).cwiseMax(kLeastShare * by_small);
    const Eigen::Vector3f off = small.strain.data()[i] - large.strain.data()[i];
    out.data()[i] = off.array().square() / variance.array();
  });
  return out;
}

// By how much the noise is larger than claimed (variances), as a gauge differs from the next larger
// one at half of the points.
Squares NoiseScale(const Image<Squares>& off_next) {
  constexpr std::size_t kEnough = 100;
  constexpr float kMedianOfChi2 = 0.4549F;  // of one degree of freedom
  Squares scale = Squares::Ones();
  for (int component = 0; component < 3; ++component) {
    std::vector<float> squares;
    for (const Squares& q : off_next.values()) {
      if (std::isfinite(q[component])) squares.push_back(q[component]);
    }
    if (squares.size() >= kEnough) scale[component] = Median(std::move(squares)) / kMedianOfChi2;
  }
  return scale;
}

// The mean over those of the (2 half + 1)^2 points about each that have a value.
Image<Squares> MeanAround(const Image<Squares>& values, int half) {
  using Sums = Eigen::Array4f;  // and the number
  const ImageSize size = values.size();
  const auto sum = [&](int n, const auto& at) {
    Sums out = Sums::Zero();
    for (int k = -half; k <= half; ++k) out += at(n + k);
    return out;
  };
  Image<Sums> along(size, Sums::Zero());
  ForEachIndex(values.pixel_count(), [&](std::size_t i) {
    const int r = static_cast<int>(i) / size.width, c = static_cast<int>(i) % size.width;
    along.data()[i] = sum(c, [&](int column) -> Sums {
      if (column < 0 || column >= size.width) return Sums::Zero();
      const Squares& q = values(r, column);
      return q.isFinite().all() ? Sums(q[0], q[1], q[2], 1) : Sums(Sums::Zero());
    });
  });
  Image<Squares> out(size, Squares::Constant(kNan));
  ForEachIndex(values.pixel_count(), [&](std::size_t i) {
    const int r = static_cast<int>(i) / size.width, c = static_cast<int>(i) % size.width;
    const Sums total = sum(r, [&](int row) -> Sums {
      return row < 0 || row >= size.height ? Sums(Sums::Zero()) : along(row, c);
    });
    if (total[3] > 0) out.data()[i] = total.head<3>() / total[3];
  });
  return out;
}

// Which of the gauges agree, by size: agrees[k] those of size k with all smaller ones.
//
// The noise is that of the three smallest, between which the surface's own strain hardly matters at
// most places. The larger one of two: noise that goes together further than claimed is seen less in
// small gauges than in large ones.
std::vector<Image<std::uint8_t>> Agreement(const std::vector<SurfaceStrain>& by_size,
                                           double sigmas) {
  constexpr std::size_t kToldNoise = 2;
  constexpr int kHalfAround = 2;
  struct Pair {
    std::size_t large;
    Image<Squares> off;  // a mean around each point
  };
  std::vector<Pair> pairs;
  Squares noise = Squares::Zero();
  for (std::size_t small = 0; small + 1 < by_size.size(); ++small) {
    for (std::size_t large = small + 1; large < by_size.size(); ++large) {
      const Image<Squares> off = Disagreement(by_size[small], by_size[large]);
      if (large == small + 1 && small < kToldNoise) noise = noise.max(NoiseScale(off));
      pairs.push_back({large, MeanAround(off, kHalfAround)});
    }
  }
  const Squares limit = static_cast<float>(sigmas * sigmas) * noise;
  std::vector<Image<std::uint8_t>> agrees(by_size.size(),
                                          Image<std::uint8_t>(by_size[0].size(), 1));
  for (const Pair& pair : pairs) {
    ForEachIndex(pair.off.pixel_count(), [&](std::size_t i) {
      if ((pair.off.data()[i] > limit).any()) agrees[pair.large].data()[i] = 0;
    });
  }
  return agrees;
}

// Which gauge is taken at a point, and which one tells what its polynomial leaves out.
struct Choice {
  std::optional<std::size_t> taken, other;
};

Choice ChooseAt(const std::vector<SurfaceStrain>& by_size,
                const std::vector<Image<std::uint8_t>>& agrees, std::size_t i) {
  Choice choice;
  for (std::size_t k = 0; k < by_size.size(); ++k) {
    if (by_size[k].status.data()[i] != Status::kOk) continue;
    if (choice.taken && agrees[k].data()[i] == 0) {
      choice.other = k;
      break;
    }
    choice.other = choice.taken;
    choice.taken = k;
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
  const ImageSize size = status.size();
  out.window_points = Image<float>(size, kNan);
  out.sigma_model = Image<Eigen::Vector3f>(size, Eigen::Vector3f::Constant(kNan));
  out.strain = by_size.back();
  const std::vector<Image<std::uint8_t>> agrees = Agreement(by_size, options_.agreement_sigmas);
  ForEachIndex(status.pixel_count(), [&](std::size_t i) {
    const Choice choice = ChooseAt(by_size, agrees, i);
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
