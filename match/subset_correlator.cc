#include "match/subset_correlator.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "match/internal/kronecker.h"
#include "match/internal/reference_subsets.h"
#include "match/internal/worst_sigma.h"

namespace plumbline {
namespace {

using internal::NormalEquations;
using internal::ReferenceSubsets;
using internal::TargetPixels;
using Subset = internal::ReferenceSubsets::Subset;

// A drop of the correlation that cannot be rounding: the step is taken back and damped.
constexpr double kWorse = 1e-4;
// Undamped step, in stop_px, up to which a search that had to be damped has converged.
constexpr double kNearly = 10;
// Share of a step left to go beyond which it is not the noise that leaves it.
constexpr double kMostLeft = 0.1;
// How far a subset may stray beyond the outermost pixels that are to be used: at the end, so that
// noise does not decide about subsets at the border of views that do not move; and on the way, so
// that a start does not.
constexpr double kBorderPx = 0.25;
constexpr double kStrayPx = 1;
// Determinant below which a warp is taken to fold the subset over.
constexpr double kFolded = 0.01;

// Variances of a raw pixel's noise in both images, in squared grey levels of the reference.
struct NoiseOfBoth {
  double reference, deformed;
  double Sum() const { return reference + deformed; }
};

double Determinant(const SubsetWarp& warp) {
  return (Eigen::Matrix2d::Identity() + warp.gradient()).determinant();
}

// The pixel that a warp counts from, and the warp from there; nothing where some point of the
// subset would leave the image.
bool Aim(const CorrelationImage& deformed, const Eigen::Vector2i& pixel, const SubsetWarp& warp,
         const Subset& subset, double stray_px, TargetPixels& target) {
  if (!warp.c.allFinite() || warp.c.col(0).cwiseAbs().maxCoeff() > 1e6) return false;
  if (!(Determinant(warp) > kFolded)) return false;
  const Eigen::Vector2d centre = pixel.cast<double>() + warp.displacement_px();
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const double x : {subset.low.x(), subset.high.x()}) {
    for (const double y : {subset.low.y(), subset.high.y()}) {
      const Eigen::Vector2d corner =
          centre + Eigen::Vector2d(x, y) + warp.gradient() * Eigen::Vector2d(x, y);
      low = low.cwiseMin(corner);
      high = high.cwiseMax(corner);
    }
  }
  const double r = std::max(-subset.low.minCoeff(), subset.high.maxCoeff());
  const Eigen::Vector2d bend = warp.c.rightCols<3>().cwiseAbs().rowwise().sum() * r * r;
  low -= bend;
  high += bend;
  const double first = deformed.edge_px() - stray_px;
  if (!(low.minCoeff() >= first) || !(high.x() <= deformed.size().width - 1 - first) ||
      !(high.y() <= deformed.size().height - 1 - first)) {
    return false;
  }
  const Eigen::Vector2d base = centre.array().floor();
  target.coefficients = deformed.coefficients() +
                        static_cast<std::ptrdiff_t>(base.y()) * deformed.stride() +
                        static_cast<std::ptrdiff_t>(base.x());
  target.stride = deformed.stride();
  target.degree = deformed.degree();
  for (int k = 0; k < 6; ++k) {
    target.warp_x[k] = static_cast<float>(warp.c(0, k) + (k == 1 ? 1 : 0));
    target.warp_y[k] = static_cast<float>(warp.c(1, k) + (k == 2 ? 1 : 0));
  }
  target.bent = !warp.c.rightCols<3>().isZero(0);
  target.warp_x[0] = static_cast<float>(centre.x() - base.x());
  target.warp_y[0] = static_cast<float>(centre.y() - base.y());
  return true;
}

// Mean over the subset of what interpolation leaves of the noise under a warp.
double TargetNoiseShare(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                        const SubsetWarp& warp, double radius) {
  if (warp.gradient().cwiseAbs().maxCoeff() * radius > 0.5) return deformed.MeanNoiseShare();
  const Eigen::Vector2d centre = pixel.cast<double>();
  double sum = 0;
  for (int j = -1; j <= 1; ++j) {
    for (int i = -1; i <= 1; ++i) {
      const Eigen::Vector2d at = centre + warp.Apply(Eigen::Vector2d(i, j) * (radius * 2 / 3));
      sum += deformed.NoiseShare(at.x(), at.y());
    }
  }
  return sum / 9;
}

}  // namespace

void CorrelatorOptions::Check() const {
  if (subset_px < 5 || subset_px > 255 || subset_px % 2 == 0) {
    throw UsageError(
        fmt::format("A subset is an odd number of pixels from 5 to 255; {} is not.", subset_px));
  }
  if (order < 0 || order > 2) {
    throw UsageError(fmt::format("The shape function's order is 0, 1 or 2; {} is not.", order));
  }
  if (order == 2 && subset_px < 9) {
    throw UsageError(fmt::format(
        "A subset of {} px does not determine a second-order shape function: take 9 px or more.",
        subset_px));
  }
  if (max_iterations < 1 || max_iterations > 255) {
    throw UsageError(fmt::format("1 to 255 iterations are possible; {} is not.", max_iterations));
  }
  if (!(stop_px > 0)) throw UsageError("The step at which iterations stop has to be above 0 px.");
  if (!(min_zncc >= 0 && min_zncc <= 1)) {
    throw UsageError(fmt::format("The lowest correlation is 0 to 1; {} is not.", min_zncc));
  }
  if (!(max_sigma_px > 0)) throw UsageError("The largest sigma has to be above 0 px.");
  if (!(min_pixel_share > 0 && min_pixel_share <= 1)) {
    throw UsageError(fmt::format(
        "The least share of a subset's pixels is above 0 up to 1; {} is not.", min_pixel_share));
  }
}

struct SubsetCorrelator::Impl {
  Impl(const CorrelationImage& image, const CorrelatorOptions& o, const Image<std::uint8_t>* mask)
      : reference(image), options(o), subsets(image, o, mask) {}

  SubsetMatch Find(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                   const SubsetWarp& start) const;
  SubsetMatch Search(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                     const SubsetWarp& start, const Subset& subset,
                     NormalEquations::Fit& fit) const;
  bool Settled(const NormalEquations& equations, const NormalEquations::Fit& fit, double lambda,
               double stop_px2) const;
  NoiseOfBoth NoiseOf(const NormalEquations::Fit& fit, const Subset& subset,
                      const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                      const SubsetWarp& warp) const;

  const CorrelationImage& reference;
  CorrelatorOptions options;
  ReferenceSubsets subsets;
};

SubsetCorrelator::SubsetCorrelator(const CorrelationImage& reference,
                                   const CorrelatorOptions& options,
                                   const Image<std::uint8_t>* mask) {
  options.Check();
  const ImageSize size = reference.size();
  if (options.subset_px > std::min(size.width, size.height)) {
    throw InputError(fmt::format("A subset of {} px does not fit into an image of {} x {} px.",
                                 options.subset_px, size.width, size.height));
  }
  if (mask != nullptr && mask->size() != size) {
    throw InputError(fmt::format("The mask has {} x {} px and the image {} x {}.", mask->width(),
                                 mask->height(), size.width, size.height));
  }
  impl_ = std::make_unique<Impl>(reference, options, mask);
}

SubsetCorrelator::~SubsetCorrelator() = default;

const CorrelatorOptions& SubsetCorrelator::options() const { return impl_->options; }

void SubsetCorrelator::Remember(const std::vector<Eigen::Vector2i>& pixels) {
  impl_->subsets.Remember(pixels);
}

SubsetMatch SubsetCorrelator::Impl::Search(const CorrelationImage& deformed,
                                           const Eigen::Vector2i& pixel, const SubsetWarp& start,
                                           const Subset& subset, NormalEquations::Fit& fit) const {
  const NormalEquations& equations = subset.facts->equations;
  SubsetMatch match;
  match.zncc = -1;
  match.warp = start;  // the best so far
  TargetPixels target;
  target.grey_offset = subset.offset;
  const double stop = options.stop_px * options.stop_px;
  double lambda = 0;
  SubsetWarp trial = start;
  SubsetWarp step;
  bool left = false;  // the image, at some step
  const auto failed = [&] { return left ? Status::kOutsideImage : Status::kNotConverged; };
  for (int i = 0; i < options.max_iterations; ++i) {
    ++match.iterations;
    const bool inside = Aim(deformed, pixel, trial, subset, kStrayPx, target);
    if (!inside && i == 0) {
      match.status = Status::kOutsideImage;
      match.zncc = SubsetMatch::kNone;
      return match;
    }
    left = left || !inside;
    NormalEquations::Fit now;
    if (inside) now = equations.Evaluate(SumTarget(subset.pixels, target, options.order));
    if (inside && now.zncc > match.zncc - kWorse) {
      match.warp = trial;
      match.zncc = now.zncc;
      fit = now;
      lambda = lambda > 1e-4 ? lambda / 10 : 0;
    } else if (lambda > 1e4) {
      match.status = failed();
      return match;
    } else {
      lambda = std::max(1e-2, 10 * lambda);
    }
    bool solved = equations.Step(fit, lambda, step);
    while (solved && !(Determinant(step) > kFolded)) {
      lambda = std::max(1e-1, 10 * lambda);
      solved = equations.Step(fit, lambda, step);
    }
    if (!solved) {
      match.status = Status::kLowCorrelation;
      return match;
    }
    trial = Compose(match.warp, Inverse(step));
    // Where noise is all that the fit leaves, a step that leaves less than that to go is the last.
    const NormalEquations::Fit after = lambda == 0 ? equations.Foreseen(fit) : fit;
    const double rest = equations.LeftAfterStep(fit);
    const bool foreseen = lambda == 0 && rest < kMostLeft && after.residual > fit.residual / 2;
    const double left_to_go = foreseen ? rest : 1;
    if (left_to_go * left_to_go * NormalEquations::MeanSquareShift(step, options.radius_px()) <
        stop) {
      const bool settled = Settled(equations, fit, lambda, stop);
      match.warp = trial;
      fit = after;
      match.zncc = fit.zncc;
      match.status = settled ? Status::kOk : failed();
      if (match.status == Status::kOk && !Aim(deformed, pixel, trial, subset, kBorderPx, target)) {
        match.status = Status::kOutsideImage;
      }
      return match;
    }
  }
  match.status = failed();
  return match;
}

// Whether it is not its damping alone that makes a step small.
bool SubsetCorrelator::Impl::Settled(const NormalEquations& equations,
                                     const NormalEquations::Fit& fit, double lambda,
                                     double stop_px2) const {
  SubsetWarp plain;
  return lambda == 0 || (equations.Step(fit, 0, plain) &&
                         NormalEquations::MeanSquareShift(plain, options.radius_px()) <
                             kNearly * kNearly * stop_px2);
}

// Variance of a raw pixel's noise, in grey levels of the reference.
NoiseOfBoth SubsetCorrelator::Impl::NoiseOf(const NormalEquations::Fit& fit, const Subset& subset,
                                            const CorrelationImage& deformed,
                                            const Eigen::Vector2i& pixel,
                                            const SubsetWarp& warp) const {
  const NormalEquations& equations = subset.facts->equations;
  const double gain2 = fit.gain * fit.gain;
  const double per_deformed = 1 / (gain2 * Determinant(warp));
  if (options.noise) {
    const double grey = equations.mean() + static_cast<double>(subset.offset);
    const double there = fit.mean + static_cast<double>(subset.offset);
    return {
        options.noise->Variance(grey) + kRoundingVarianceGrey2,
        (options.deformed_noise.value_or(*options.noise).Variance(there) + kRoundingVarianceGrey2) *
            per_deformed};
  }
  // Both images have the same noise; the unknowns take their share of the residual.
  const double unknowns = equations.unknowns() + 2;
  const double shares = (reference.NoiseShare(0, 0) * gain2 +
                         TargetNoiseShare(deformed, pixel, warp, options.radius_px())) *
                            subset.facts->count -
                        (gain2 + 1) * unknowns;
  const double one_image = std::max(fit.residual / std::max(shares, 1.0), kRoundingVarianceGrey2);
  return {one_image, one_image * per_deformed};
}

SubsetMatch SubsetCorrelator::Impl::Find(const CorrelationImage& deformed,
                                         const Eigen::Vector2i& pixel,
                                         const SubsetWarp& start) const {
  static thread_local Subset subset;
  subsets.Take(pixel, subset);
  SubsetMatch match;
  match.status = subset.facts->status;
  if (match.status != Status::kOk) return match;
  if (!start.c.allFinite() || !(Determinant(start) > kFolded)) {
    match.status = Status::kNotConverged;
    return match;
  }
  if (!subset.facts->equations.solvable()) {
    match.status = Status::kLowTexture;
    return match;
  }
  NormalEquations::Fit fit;
  match = Search(deformed, pixel, start, subset, fit);
  if (match.status != Status::kOk) return match;
  if (match.zncc < options.min_zncc) {
    match.status = Status::kLowCorrelation;
    return match;
  }
  const NoiseOfBoth variance = NoiseOf(fit, subset, deformed, pixel, match.warp);
  const NormalEquations::Covariance covariance =
      variance.Sum() * subset.facts->covariance_per_variance;
  match.noise_grey = std::sqrt(variance.Sum() / (1 + 1 / (fit.gain * fit.gain)));
  match.reference_share = variance.reference / variance.Sum();
  const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + match.warp.gradient();
  const int v = static_cast<int>(covariance.rows()) / 2;
  Eigen::Matrix2d of_shift;
  of_shift << covariance(0, 0), covariance(0, v), covariance(v, 0), covariance(v, v);
  match.cov_displacement_px2 = F * of_shift * F.transpose();
  if (options.order > 0) {
    const int places[4] = {1, 2, 4, 5};
    Eigen::Matrix4d of_gradient;
    for (int i = 0; i < 4; ++i) {
      for (int k = 0; k < 4; ++k) of_gradient(i, k) = covariance(places[i], places[k]);
    }
    const Eigen::Matrix4d turn = internal::Kronecker(F, Eigen::Matrix2d::Identity());
    match.cov_gradient = turn * of_gradient * turn.transpose();
  }
  if (!(internal::WorstSigma(match.cov_displacement_px2) <= options.max_sigma_px)) {
    match.status = Status::kLowTexture;
  }
  return match;
}

SubsetMatch SubsetCorrelator::Match(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                                    const SubsetWarp& start) const {
  if (deformed.options() != impl_->reference.options()) {
    throw std::invalid_argument("SubsetCorrelator: both images are prepared with the same options");
  }
  const SubsetMatch match = impl_->Find(deformed, pixel, start);
  if (match.status == Status::kOk) return match;
  SubsetMatch none;
  none.status = match.status;
  none.zncc = match.zncc;
  none.iterations = match.iterations;
  if (match.status == Status::kOutsideImage) none.warp = match.warp;
  return none;
}

double SubsetCorrelator::Zncc(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                              const SubsetWarp& warp) const {
  static thread_local Subset subset;
  impl_->subsets.Take(pixel, subset);
  TargetPixels target;
  if (subset.facts->status != Status::kOk ||
      !Aim(deformed, pixel, warp, subset, kBorderPx, target)) {
    return SubsetMatch::kNone;
  }
  target.grey_offset = subset.offset;
  const internal::ReferenceSums f = SumReference(subset.pixels, 0);
  const internal::TargetSums g = SumTarget(subset.pixels, target, 2);
  const double n = subset.facts->count;
  const double norm = (f.ff - f.f * f.f / n) * (g.gg - g.g * g.g / n);
  return norm > 0 ? (g.fg - f.f * g.g / n) / std::sqrt(norm) : SubsetMatch::kNone;
}

}  // namespace plumbline
