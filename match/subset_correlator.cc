#include "match/subset_correlator.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "match/internal/kronecker.h"
#include "match/internal/normal_equations.h"
#include "match/internal/subset_sums.h"
#include "match/internal/worst_sigma.h"

namespace plumbline {
namespace {

using internal::NormalEquations;
using internal::PackedSubset;
using internal::ProductSums;
using internal::TargetPixels;

// A drop of the correlation that cannot be rounding: the step is taken back and damped.
constexpr double kWorse = 1e-4;
// Undamped step, in stop_px, up to which a search that had to be damped has converged.
constexpr double kNearly = 10;
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

// Offsets from the centre that a subset reaches, those cut off by the image left out.
struct Reach {
  Eigen::Vector2d low, high;
};

// The pixel that a warp counts from, and the warp from there; nothing where some point of the
// subset would leave the image.
bool Aim(const CorrelationImage& deformed, const Eigen::Vector2i& pixel, const SubsetWarp& warp,
         const Reach& reach, double stray_px, TargetPixels& target) {
  if (!warp.c.allFinite() || warp.c.col(0).cwiseAbs().maxCoeff() > 1e6) return false;
  if (!(Determinant(warp) > kFolded)) return false;
  const Eigen::Vector2d centre = pixel.cast<double>() + warp.displacement_px();
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const double x : {reach.low.x(), reach.high.x()}) {
    for (const double y : {reach.low.y(), reach.high.y()}) {
      const Eigen::Vector2d corner =
          centre + Eigen::Vector2d(x, y) + warp.gradient() * Eigen::Vector2d(x, y);
      low = low.cwiseMin(corner);
      high = high.cwiseMax(corner);
    }
  }
  const double r = std::max(-reach.low.minCoeff(), reach.high.maxCoeff());
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

// The mask without its pixels within this distance (along x or y) of those that it leaves out.
Image<std::uint8_t> Eroded(const Image<std::uint8_t>& mask, int distance) {
  Image<std::uint8_t> along_x(mask.size(), 1);
  Image<std::uint8_t> eroded(mask.size(), 1);
  for (int y = 0; y < mask.height(); ++y) {
    int done = 0;
    for (int x = 0; x < mask.width(); ++x) {
      if (mask(y, x) != 0) continue;
      const int end = std::min(mask.width(), x + distance + 1);
      std::fill(along_x.row(y) + std::max(done, x - distance), along_x.row(y) + end,
                std::uint8_t{0});
      done = end;
    }
  }
  for (int y = 0; y < mask.height(); ++y) {
    for (int k = std::max(0, y - distance); k <= std::min(mask.height() - 1, y + distance); ++k) {
      const std::uint8_t* from = along_x.row(k);
      std::uint8_t* to = eroded.row(y);
      for (int x = 0; x < mask.width(); ++x) to[x] &= from[x];
    }
  }
  return eroded;
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
  const CorrelationImage& reference;
  CorrelatorOptions options;
  const Image<std::uint8_t>* mask;
  Image<std::uint8_t> pixels_used;  // the mask less its edge; empty without one
  internal::SubsetOutline outline;
  internal::ReferencePlanes planes;
  bool filtered;
  int full_count = 0;

  // What is known of a subset before it is looked for.
  struct Subset {
    PackedSubset pixels;
    int count = 0;
    float offset = 0;
    Reach reach;
  };

  int CountInside(const Eigen::Vector2i& pixel) const;
  Status Take(const Eigen::Vector2i& pixel, Subset& subset) const;
  SubsetMatch Find(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                   const SubsetWarp& start) const;
  SubsetMatch Search(const CorrelationImage& deformed, const Eigen::Vector2i& pixel,
                     const SubsetWarp& start, const Subset& subset,
                     const NormalEquations& equations, NormalEquations::Fit& fit) const;
  bool Settled(const NormalEquations& equations, const NormalEquations::Fit& fit, double lambda,
               double stop_px2) const;
  NoiseOfBoth NoiseOf(const NormalEquations& equations, const NormalEquations::Fit& fit,
                      const Subset& subset, const CorrelationImage& deformed,
                      const Eigen::Vector2i& pixel, const SubsetWarp& warp) const;
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
  const int radius = options.radius_px();
  auto impl = std::make_unique<Impl>(Impl{reference,
                                          options,
                                          mask,
                                          {},
                                          options.shape == SubsetShape::kCircle
                                              ? internal::SubsetOutline::Circle(radius)
                                              : internal::SubsetOutline::Square(radius),
                                          {},
                                          reference.options().prefilter != Prefilter::kNone});
  for (std::size_t i = 0; i < impl->outline.begin.size(); ++i) {
    impl->full_count += impl->outline.end[i] - impl->outline.begin[i];
  }
  if (mask != nullptr) impl->pixels_used = Eroded(*mask, reference.edge_px());
  impl->planes = {&reference.grey(),
                  &reference.gradient_x(),
                  &reference.gradient_y(),
                  impl->filtered ? &reference.noise_gradient_x() : nullptr,
                  impl->filtered ? &reference.noise_gradient_y() : nullptr,
                  mask != nullptr ? &impl->pixels_used : nullptr,
                  reference.edge_px()};
  impl_ = std::move(impl);
}

SubsetCorrelator::~SubsetCorrelator() = default;

const CorrelatorOptions& SubsetCorrelator::options() const { return impl_->options; }

// Pixels of a subset that lie in the image and the mask.
int SubsetCorrelator::Impl::CountInside(const Eigen::Vector2i& pixel) const {
  const ImageSize size = reference.size();
  int count = 0;
  for (std::size_t i = 0; i < outline.begin.size(); ++i) {
    const int y = pixel.y() + static_cast<int>(i) - outline.radius;
    if (y < 0 || y >= size.height) continue;
    const int first = std::max(0, pixel.x() + outline.begin[i]);
    const int last = std::min(size.width, pixel.x() + outline.end[i]);
    if (mask == nullptr) {
      count += std::max(0, last - first);
    } else {
      const std::uint8_t* row = mask->row(y);
      for (int x = first; x < last; ++x) count += row[x] != 0 ? 1 : 0;
    }
  }
  return count;
}

// kOk, or why there is nothing to look for.
Status SubsetCorrelator::Impl::Take(const Eigen::Vector2i& pixel, Subset& subset) const {
  const ImageSize size = reference.size();
  if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() >= size.width || pixel.y() >= size.height) {
    return Status::kOutsideImage;
  }
  if (mask != nullptr && (*mask)(pixel.y(), pixel.x()) == 0) return Status::kMasked;
  const int r = options.radius_px();
  const int edge = reference.edge_px();
  const Eigen::Vector2i last(size.width - 1, size.height - 1);
  subset.reach.low = (Eigen::Vector2i::Constant(edge) - pixel).cwiseMax(-r).cast<double>();
  subset.reach.high = (last - Eigen::Vector2i::Constant(edge) - pixel).cwiseMin(r).cast<double>();
  subset.offset = reference.grey()(pixel.y(), pixel.x());
  subset.count =
      internal::Pack(planes, outline, pixel.x(), pixel.y(), subset.offset, subset.pixels);
  const int unknowns = 2 * internal::kShapeTerms[options.order] + 2;
  if (subset.count < 2 * unknowns || CountInside(pixel) < options.min_pixel_share * full_count) {
    const bool inside = (pixel.array() - r).minCoeff() >= 0 && (last - pixel).minCoeff() >= r;
    return inside ? Status::kMasked : Status::kOutsideImage;
  }
  return Status::kOk;
}

SubsetMatch SubsetCorrelator::Impl::Search(const CorrelationImage& deformed,
                                           const Eigen::Vector2i& pixel, const SubsetWarp& start,
                                           const Subset& subset, const NormalEquations& equations,
                                           NormalEquations::Fit& fit) const {
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
    const bool inside = Aim(deformed, pixel, trial, subset.reach, kStrayPx, target);
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
    if (NormalEquations::MeanSquareShift(step, options.radius_px()) < stop) {
      match.warp = trial;
      match.status = Settled(equations, fit, lambda, stop) ? Status::kOk : failed();
      if (match.status == Status::kOk &&
          !Aim(deformed, pixel, trial, subset.reach, kBorderPx, target)) {
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
NoiseOfBoth SubsetCorrelator::Impl::NoiseOf(const NormalEquations& equations,
                                            const NormalEquations::Fit& fit, const Subset& subset,
                                            const CorrelationImage& deformed,
                                            const Eigen::Vector2i& pixel,
                                            const SubsetWarp& warp) const {
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
                            subset.count -
                        (gain2 + 1) * unknowns;
  const double one_image = std::max(fit.residual / std::max(shares, 1.0), kRoundingVarianceGrey2);
  return {one_image, one_image * per_deformed};
}

SubsetMatch SubsetCorrelator::Impl::Find(const CorrelationImage& deformed,
                                         const Eigen::Vector2i& pixel,
                                         const SubsetWarp& start) const {
  static thread_local Subset subset;
  SubsetMatch match;
  match.status = Take(pixel, subset);
  if (match.status != Status::kOk) return match;
  const int order = options.order;
  if (!start.c.allFinite() || !(Determinant(start) > kFolded)) {
    match.status = Status::kNotConverged;
    return match;
  }
  const NormalEquations equations(
      order, subset.count, SumReference(subset.pixels, order),
      SumProducts(subset.pixels, subset.pixels.gradient_x, subset.pixels.gradient_y, order));
  if (!equations.solvable()) {
    match.status = Status::kLowTexture;
    return match;
  }
  NormalEquations::Fit fit;
  match = Search(deformed, pixel, start, subset, equations, fit);
  if (match.status != Status::kOk) return match;
  if (match.zncc < options.min_zncc) {
    match.status = Status::kLowCorrelation;
    return match;
  }
  ProductSums noise;
  if (filtered) {
    noise = SumProducts(subset.pixels, subset.pixels.noise_x, subset.pixels.noise_y, order);
  }
  const NoiseOfBoth variance = NoiseOf(equations, fit, subset, deformed, pixel, match.warp);
  const NormalEquations::Covariance covariance =
      variance.Sum() * equations.CovariancePerVariance(filtered ? &noise : nullptr);
  match.noise_grey = std::sqrt(variance.Sum() / (1 + 1 / (fit.gain * fit.gain)));
  match.reference_share = variance.reference / variance.Sum();
  const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + match.warp.gradient();
  const int v = static_cast<int>(covariance.rows()) / 2;
  Eigen::Matrix2d of_shift;
  of_shift << covariance(0, 0), covariance(0, v), covariance(v, 0), covariance(v, v);
  match.cov_displacement_px2 = F * of_shift * F.transpose();
  if (order > 0) {
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
  static thread_local Impl::Subset subset;
  TargetPixels target;
  if (impl_->Take(pixel, subset) != Status::kOk ||
      !Aim(deformed, pixel, warp, subset.reach, kBorderPx, target)) {
    return SubsetMatch::kNone;
  }
  target.grey_offset = subset.offset;
  const internal::ReferenceSums f = SumReference(subset.pixels, 0);
  const internal::TargetSums g = SumTarget(subset.pixels, target, 2);
  const double n = subset.count;
  const double norm = (f.ff - f.f * f.f / n) * (g.gg - g.g * g.g / n);
  return norm > 0 ? (g.fg - f.f * g.g / n) / std::sqrt(norm) : SubsetMatch::kNone;
}

}  // namespace plumbline
