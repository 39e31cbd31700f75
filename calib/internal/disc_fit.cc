#include "calib/internal/disc_fit.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "calib/internal/disc_shape.h"
#include "calib/internal/two_level_fit.h"

namespace plumbline::internal {
namespace {

using Sample = TwoLevelFit<DiscShape<false>>::Sample;

// The pixels within `reach`; none when the disc itself leaves the image.
std::vector<Sample> Collect(const GrayImage& image, const Ellipse& start, double reach) {
  const Eigen::Matrix2d spread = start.shape.inverse();
  const double wx = reach * std::sqrt(spread(0, 0)), wy = reach * std::sqrt(spread(1, 1));
  const int x0 = static_cast<int>(std::ceil(start.centre.x() - wx));
  const int x1 = static_cast<int>(std::floor(start.centre.x() + wx));
  const int y0 = static_cast<int>(std::ceil(start.centre.y() - wy));
  const int y1 = static_cast<int>(std::floor(start.centre.y() + wy));
  std::vector<Sample> samples;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Eigen::Vector2d p(x, y);
      const double rho = start.NormalisedRadius(p);
      if (rho > reach) continue;
      if (x < 0 || y < 0 || x >= image.width() || y >= image.height()) {
        if (rho < 1.03) return {};
        continue;
      }
      samples.push_back({p - start.centre, static_cast<double>(image.grey(y, x))});
    }
  }
  return samples;
}

struct Levels {
  double background = 0, disc = 0;
};

// Levels from the pixels clearly outside and clearly on the disc.
std::optional<Levels> StartLevels(const std::vector<Sample>& samples, const Ellipse& start,
                                  double reach, bool ring) {
  double sum[2] = {}, count[2] = {};
  for (const Sample& s : samples) {
    const double rho = start.NormalisedRadius(s.p + start.centre);
    const bool outside = rho > 0.5 * (1 + reach), on = rho < 0.75 && (!ring || rho > 0.5);
    if (!outside && !on) continue;
    sum[on] += s.grey;
    count[on] += 1;
  }
  if (count[0] < 8 || count[1] < 3) return std::nullopt;
  return Levels{sum[0] / count[0], sum[1] / count[1]};
}

template <bool kRing>
std::optional<DiscFit> Fit(const GrayImage& image, const Ellipse& start, double reach) {
  using Solver = TwoLevelFit<DiscShape<kRing>>;
  const std::vector<Sample> collected = Collect(image, start, reach);
  const auto levels = StartLevels(collected, start, reach, kRing);
  if (!levels) return std::nullopt;
  std::vector<typename Solver::Sample> samples;
  samples.reserve(collected.size());
  for (const Sample& s : collected) samples.push_back({s.p, s.grey});

  const double radius = start.MeanRadiusPx();
  typename Solver::Parameters q = Solver::Parameters::Zero();
  q.template segment<3>(DiscShape<kRing>::kShape) << start.shape(0, 0), start.shape(0, 1),
      start.shape(1, 1);
  q[DiscShape<kRing>::kBlur] = std::min(0.8, 0.3 * radius);
  if constexpr (kRing) q[DiscShape<kRing>::kHoleSize] = 0.4;
  Solver solver({start}, std::move(samples), radius);
  const auto result = solver.Run(q, levels->background, levels->disc);
  if (!result) return std::nullopt;
  DiscFit fit;
  fit.ellipse.centre = start.centre + result->geometry.template head<2>();
  fit.ellipse.shape = DiscShape<kRing>::Matrix(result->geometry);
  fit.cov_px2 = result->cov_position;
  fit.blur_px = result->geometry[DiscShape<kRing>::kBlur];
  fit.contrast = result->bright[0] - result->covered[0];
  fit.residual = result->residual;
  return fit;
}

}  // namespace

double Ellipse::AreaPx2() const { return std::numbers::pi / std::sqrt(shape.determinant()); }

double Ellipse::MeanRadiusPx() const { return std::pow(shape.determinant(), -0.25); }

double Ellipse::NormalisedRadius(const Eigen::Vector2d& p) const {
  const Eigen::Vector2d offset = p - centre;
  return std::sqrt(std::max(offset.dot(shape * offset), 0.0));
}

std::optional<DiscFit> FitDisc(const GrayImage& image, const Ellipse& start, double reach,
                               bool ring) {
  return ring ? Fit<true>(image, start, reach) : Fit<false>(image, start, reach);
}

}  // namespace plumbline::internal
