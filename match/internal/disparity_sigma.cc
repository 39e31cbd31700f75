#include "match/internal/disparity_sigma.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace plumbline::internal {
namespace {

float HorizontalGradient(const Image<std::uint16_t>& grey, int x, int y) {
  return (static_cast<float>(grey(y, x + 1)) - static_cast<float>(grey(y, x - 1))) / 2;
}

float VerticalGradient(const Image<std::uint16_t>& grey, int x, int y) {
  return (static_cast<float>(grey(y + 1, x)) - static_cast<float>(grey(y - 1, x))) / 2;
}

struct Sample {
  double residual2, gx2, gy2;
};

std::vector<Sample> ResidualSamples(const RefinedDisparity& refined, const GrayImage& left) {
  constexpr float kAlike = 0.7F;  // windows that are surely of the same surface
  std::vector<Sample> samples;
  for (int y = 1; y + 1 < left.height(); y += 2) {
    for (int x = 1; x + 1 < left.width(); ++x) {
      if (refined.outcome(y, x) != RefineOutcome::kRefined) continue;
      if (!(refined.correlation(y, x) > kAlike)) continue;
      const auto e = static_cast<double>(refined.residual_grey(y, x));
      if (!std::isfinite(e)) continue;
      const auto gx = static_cast<double>(HorizontalGradient(left.grey, x, y));
      const auto gy = static_cast<double>(VerticalGradient(left.grey, x, y));
      samples.push_back({e * e, gx * gx, gy * gy});
    }
  }
  return samples;
}

// The sum over pixels of a(y, x) a(y + v, x + u) for a = residual and a = gradient, both in units
// of the window's noise.
struct LagSums {
  double residual = 0, gradient = 0;
  std::int64_t count = 0;
};

LagSums SumAtLag(const Image<float>& e, const Image<float>& g, int u, int v) {
  LagSums sums;
  for (int y = 0; y + v < e.height(); y += 3) {  // every third row is plenty
    for (int x = std::max(0, -u); x < std::min(e.width(), e.width() - u); ++x) {
      const float ee = e(y, x) * e(y + v, x + u);
      if (!(std::abs(ee) < 25)) continue;
      sums.residual += static_cast<double>(ee);
      sums.gradient += static_cast<double>(g(y, x) * g(y + v, x + u));
      ++sums.count;
    }
  }
  return sums;
}

}  // namespace

double CorrelatedNoiseFactor(const RefinedDisparity& refined, const GrayImage& left,
                             int radius_px) {
  Image<float> residual(left.size(), std::numeric_limits<float>::quiet_NaN());
  Image<float> gradient(left.size(), 0.0F);
  for (int y = 0; y < left.height(); ++y) {
    for (int x = 1; x + 1 < left.width(); ++x) {
      residual(y, x) = refined.residual_grey(y, x) / refined.noise_grey(y, x);
      gradient(y, x) = HorizontalGradient(left.grey, x, y) / refined.noise_grey(y, x);
    }
  }
  const LagSums zero = SumAtLag(residual, gradient, 0, 0);
  constexpr std::int64_t kFewest = 1000;
  if (zero.count < kFewest || !(zero.residual > 0) || !(zero.gradient > 0)) return 1;
  const auto n0 = static_cast<double>(zero.count);
  double factor = 1;
  for (int v = 0; v <= radius_px; ++v) {
    for (int u = v == 0 ? 1 : -radius_px; u <= radius_px; ++u) {
      const LagSums sums = SumAtLag(residual, gradient, u, v);
      if (sums.count < kFewest) continue;
      const auto n = static_cast<double>(sums.count);
      // Each lag stands for its mirror image too.
      factor += 2 * (sums.residual / n) / (zero.residual / n0) * (sums.gradient / n) /
                (zero.gradient / n0);
    }
  }
  return std::max(1.0, factor);
}

double VerticalMisfit(const RefinedDisparity& refined, const GrayImage& left) {
  const std::vector<Sample> samples = ResidualSamples(refined, left);
  constexpr std::size_t kFewest = 1000;
  if (samples.size() < kFewest) return 0;
  std::vector<double> squares;
  for (const Sample& s : samples) squares.push_back(s.residual2);
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  const double floor = std::max(0.1, *middle);
  // residual^2 = noise^2 + gx^2 a + gy^2 b, reweighted by the fitted value; what is 3 sigma off is
  // no noise.
  Eigen::Vector3d fit(floor, 0.05, 0.05);
  double sigma_fit = 0;
  for (int pass = 0; pass < 6; ++pass) {
    Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    for (const Sample& s : samples) {
      const Eigen::Vector3d row(1, s.gx2, s.gy2);
      const double expected = std::max(floor / 2, row.dot(fit));
      if (pass > 0 && s.residual2 > 9 * expected) continue;
      const double weight = 1 / (expected * expected);
      N += weight * row * row.transpose();
      b += weight * s.residual2 * row;
    }
    const Eigen::LDLT<Eigen::Matrix3d> ldlt(N);
    if (!ldlt.isPositive()) return 0;
    fit = ldlt.solve(b);
    if (!fit.allFinite()) return 0;
    // A squared normal deviate of mean m has the variance 2 m^2.
    sigma_fit = std::sqrt(2 * ldlt.solve(Eigen::Vector3d::Unit(2))[2]);
  }
  return std::max(0.0, fit[2] - 3 * sigma_fit);  // only what stands out of its own noise
}

Image<float> DisparitySigma(const RefinedDisparity& refined, const GrayImage& left, int radius_px) {
  const SigmaModel model;
  const double kappa = CorrelatedNoiseFactor(refined, left, radius_px);
  const double misfit = VerticalMisfit(refined, left);
  const double misfit_px2 = model.misfit_px2 * misfit / (misfit + model.misfit_saturation_px2);
  Image<float> sigma(left.size(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t i = 0; i < sigma.pixel_count(); ++i) {
    const RefineOutcome outcome = refined.outcome.data()[i];
    const double relief2 = std::pow(static_cast<double>(refined.relief_px.data()[i]), 2);
    double variance = std::numeric_limits<double>::quiet_NaN();
    if (outcome == RefineOutcome::kRefined) {
      variance = model.noise * kappa * static_cast<double>(refined.variance_px2.data()[i]) +
                 misfit_px2 + model.relief * relief2;
    } else if (outcome == RefineOutcome::kStayed) {
      variance = model.stayed_px2 + model.stayed_relief * relief2;
    }
    sigma.data()[i] = static_cast<float>(std::sqrt(variance));
  }
  return sigma;
}

}  // namespace plumbline::internal
