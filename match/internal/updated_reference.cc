#include "match/internal/updated_reference.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "match/internal/kronecker.h"
#include "match/internal/propagation.h"
#include "match/internal/verify_field.h"

namespace plumbline::internal {
namespace {

// What an error of the gradient (row by row) does at an offset.
Eigen::Matrix2d AtOffset(const Eigen::Matrix4d& cov_gradient, const Eigen::Vector2d& offset) {
  Eigen::Matrix<double, 2, 4> J = Eigen::Matrix<double, 2, 4>::Zero();
  J.block<1, 2>(0, 0) = J.block<1, 2>(1, 2) = offset.transpose();
  return J * cov_gradient * J.transpose();
}

// The mask of the first image as the points of a field carry it along: each pixel asks the nearest
// point whose subset holds it.
Image<std::uint8_t> CarryMask(const Image<std::uint8_t>& mask, const PlanarField& base,
                              const Image<Eigen::Vector2i>& pixels, int radius) {
  if (mask.empty()) return {};
  Image<std::uint8_t> carried(mask.size(), 0);
  Image<float> nearest(mask.size(), std::numeric_limits<float>::infinity());
  for (int r = 0; r < base.size().height; ++r) {
    for (int c = 0; c < base.size().width; ++c) {
      if (base.status(r, c) != Status::kOk) continue;
      const Eigen::Vector2d at = base.PixelOf(r, c) + base.displacement_px(r, c);
      const Eigen::Matrix2d F = Eigen::Matrix2d::Identity() + base.gradient(r, c).cast<double>();
      if (!(F.determinant() > 0.01)) continue;
      const Eigen::Matrix2d back = F.inverse();
      const Eigen::Vector2i centre = pixels(r, c);
      for (int y = std::max(0, centre.y() - radius);
           y <= std::min(mask.height() - 1, centre.y() + radius); ++y) {
        for (int x = std::max(0, centre.x() - radius);
             x <= std::min(mask.width() - 1, centre.x() + radius); ++x) {
          const Eigen::Vector2d by = Eigen::Vector2d(x, y) - at;
          const auto distance = static_cast<float>(by.squaredNorm());
          if (distance >= nearest(y, x)) continue;
          nearest(y, x) = distance;
          const Eigen::Vector2d from = (base.PixelOf(r, c) + back * by).array().round();
          carried(y, x) =
              from.minCoeff() >= 0 && from.x() < mask.width() && from.y() < mask.height()
                  ? mask(static_cast<int>(from.y()), static_cast<int>(from.x()))
                  : 0;
        }
      }
    }
  }
  for (std::size_t i = 0; i < pixels.pixel_count(); ++i) {
    const Eigen::Vector2i& at = pixels.data()[i];
    if (base.status.data()[i] == Status::kOk && at.minCoeff() >= 0 && at.x() < mask.width() &&
        at.y() < mask.height()) {
      carried(at.y(), at.x()) = 1;  // whose subset lost its centre to rounding
    }
  }
  return carried;
}

// What white noise of variance 1 leaves, in the mean, of the product of its own gradient and
// another image's noise, both filtered: sum over offsets of their autocorrelations.
double NoiseOfWeights(const CorrelationImageOptions& options) {
  constexpr int kSide = 65;
  GrayImage impulse{Image<std::uint16_t>({kSide, kSide}, 0), 16};
  impulse.grey(kSide / 2, kSide / 2) = 10000;
  const CorrelationImage answer(impulse, options);
  double sum = 0;
  for (const float g : answer.noise_gradient_x().values()) sum += static_cast<double>(g) * g;
  return sum / 1e8;
}

Image<Eigen::Vector2i> PixelsOf(const PlanarField& base) {
  Image<Eigen::Vector2i> pixels(base.size(), Eigen::Vector2i(-1, -1));
  for (int r = 0; r < base.size().height; ++r) {
    for (int c = 0; c < base.size().width; ++c) {
      if (base.status(r, c) != Status::kOk) continue;
      pixels(r, c) = (base.PixelOf(r, c) + base.displacement_px(r, c)).array().round().cast<int>();
    }
  }
  return pixels;
}

}  // namespace

UpdatedReference::UpdatedReference(const GrayImage& image, const ComposedField& base,
                                   const Image<std::uint8_t>& mask, const FieldOptions& options)
    : options_(options),
      raw_(image),
      base_(base.total.field),
      base_leg_(base.leg),
      base_offset_px_(base.offset_px),
      pixels_(PixelsOf(base_)),
      mask_(CarryMask(mask, base_, pixels_, options.correlator.radius_px())),
      reference_(image, options.image),
      correlator_(reference_, options.correlator, mask_.empty() ? nullptr : &mask_) {
  noise_of_weights_ = NoiseOfWeights(options.image);
  if (options.correlator.shape == SubsetShape::kCircle) {
    noise_of_weights_ *= std::numbers::pi / 4;
  }
  const CorrelatorOptions& o = options.correlator;
  lost_a_px_ =
      1 - static_cast<double>(NeighbourCorrelation::OfOverlap({2, 1}, 1, o.subset_px, o.order,
                                                              o.shape == SubsetShape::kCircle)
                                  .Between(0, 0, 0, 1)(0, 0));
  // Of a part of a pixel's noise, its square; and what the filter leaves along one axis.
  lost_a_px_ *= std::sqrt(reference_.NoiseShare(0, 0));
  for (const Status status : base_.status.values()) {
    lost_ += status != Status::kOk && status != Status::kMasked ? 1 : 0;
  }
}

ComposedField UpdatedReference::Correlate(const GrayImage& deformed,
                                          const FieldStart& start) const {
  const CorrelationImage prepared(deformed, options_.image);
  ComposedField best;
  if (start.prior != nullptr) {
    const PlanarField& prior = *start.prior;
    std::vector<Propagation::Start> starts;
    for (std::size_t i = 0; i < prior.status.pixel_count(); ++i) {
      if (prior.status.data()[i] != Status::kOk || base_.status.data()[i] != Status::kOk) continue;
      starts.emplace_back(
          static_cast<std::int64_t>(i),
          SubsetWarp::Of(prior.displacement_px.data()[i], prior.gradient.data()[i].cast<double>()));
    }
    best = From(deformed, prepared, starts, start, false);
    if (!start.search || (best.total.counts.ok * 2 >= static_cast<std::int64_t>(starts.size()) &&
                          best.total.counts.ok > 0)) {
      return best;
    }
  }
  const Image<std::uint8_t>* const mask = mask_.empty() ? nullptr : &mask_;
  const std::vector<CorrelationSeed> seeds =
      start.seeds ? start.seeds(deformed) : FindSeeds(raw_, deformed, mask, options_.seeds);
  ComposedField anew = From(deformed, prepared, StartsOf(seeds), start, true);
  return start.prior == nullptr || anew.total.counts.ok > best.total.counts.ok ? anew : best;
}

// Each seed at the nearest point.
std::vector<Propagation::Start> UpdatedReference::StartsOf(
    const std::vector<CorrelationSeed>& seeds) const {
  std::vector<Propagation::Start> starts;
  const double reach = std::max(options_.step_px, options_.correlator.subset_px);
  for (const CorrelationSeed& seed : seeds) {
    double nearest = reach * reach;
    std::int64_t point = -1;
    for (std::size_t i = 0; i < pixels_.pixel_count(); ++i) {
      if (base_.status.data()[i] != Status::kOk) continue;
      const double distance = (pixels_.data()[i].cast<double>() - seed.reference_px).squaredNorm();
      if (distance >= nearest) continue;
      nearest = distance;
      point = static_cast<std::int64_t>(i);
    }
    if (point < 0) continue;
    starts.emplace_back(point,
                        SubsetWarp::Of(seed.displacement_px, seed.gradient)
                            .MovedTo(pixels_.data()[point].cast<double>() - seed.reference_px));
  }
  return starts;
}

ComposedField UpdatedReference::From(const GrayImage& image, const CorrelationImage& deformed,
                                     const std::vector<Propagation::Start>& starts,
                                     const FieldStart& start, bool from_seeds) const {
  ComposedField result;
  result.leg = PlanarField(base_.size(), base_.first_px, base_.step_px);
  result.leg.subset_px = base_.subset_px;
  result.leg.order = base_.order;
  result.offset_px = Image<Eigen::Vector2f>(base_.size(), Eigen::Vector2f::Zero());
  for (std::size_t i = 0; i < base_.status.pixel_count(); ++i) {
    if (base_.status.data()[i] != Status::kOk) result.leg.status.data()[i] = Status::kMasked;
  }
  FieldCounts& counts = result.total.counts;
  Propagation propagation(correlator_, deformed, result.leg, &pixels_, start.curvature);
  propagation.Try(starts);
  propagation.Spread();
  counts.seeds = static_cast<std::int64_t>(starts.size());
  if (options_.verify && (from_seeds || start.verify_back)) {
    RejectNotFoundBack({raw_, reference_, image, deformed, mask_.empty() ? nullptr : &mask_},
                       options_, propagation, result.leg, counts);
  }
  result.total.field = result.leg;
  for (std::size_t i = 0; i < base_.status.pixel_count(); ++i) {
    const auto point = static_cast<std::int64_t>(i);
    if (base_.status.data()[i] != Status::kOk) {
      TakeBack(point, base_.status.data()[i], result.total.field);
    } else if (result.leg.status.data()[i] == Status::kOk) {
      SubsetWarp warp;
      warp.c = propagation.WarpOf(point).cast<double>();
      warp.c.col(0) = result.leg.displacement_px.data()[i];
      Compose(point, warp, result);
    }
  }
  if (options_.verify) RejectParts(options_.keep_still_parts, result.total.field, counts);
  CountStatuses(result.total.field, counts);
  return result;
}

UpdatedReference::NoiseBias UpdatedReference::BiasOf(std::int64_t point,
                                                     const PlanarField& leg) const {
  const auto i = static_cast<std::size_t>(point);
  const Eigen::Vector2i centre = pixels_.data()[i];
  const int radius = options_.correlator.radius_px();
  const bool circle = options_.correlator.shape == SubsetShape::kCircle;
  const Image<float>& grey = reference_.grey();
  Eigen::Matrix<double, 6, 1> J;
  Eigen::Matrix<double, 6, 1> of_J = Eigen::Matrix<double, 6, 1>::Zero();
  Eigen::Matrix<double, 6, 1> q = of_J;
  double n = 0, sum = 0, squares = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const int c = centre.x() + x;
      const int r = centre.y() + y;
      if (c < 0 || r < 0 || c >= grey.width() || r >= grey.height()) continue;
      if ((circle && x * x + y * y > radius * radius) || (!mask_.empty() && mask_(r, c) == 0)) {
        continue;
      }
      const double f = grey(r, c);
      const double gx = reference_.gradient_x()(r, c);
      const double gy = reference_.gradient_y()(r, c);
      J << gx, gy, x * gx, y * gx, x * gy, y * gy;
      n += 1;
      sum += f;
      squares += f * f;
      q += J * f;
      of_J += J;
    }
  }
  NoiseBias bias;
  const double S = squares - sum * sum / n;
  if (!(S > 0)) return bias;
  q -= of_J * (sum / n);
  const double share = n * reference_.NoiseShare(0, 0) / S / 2;  // H^-1 s^2 = L / 2
  bias.displacement_px = -share * CovarianceOf(leg.cov_displacement_px2.data()[i]) * q.head<2>();
  if (options_.correlator.order > 0) {
    bias.gradient = -share * CovarianceOf(leg.cov_gradient.data()[i]) * q.tail<4>();
  }
  return bias;
}

void UpdatedReference::Compose(std::int64_t point, const SubsetWarp& warp,
                               ComposedField& result) const {
  const auto i = static_cast<std::size_t>(point);
  PlanarField& total = result.total.field;
  const int columns = base_.size().width;
  const Eigen::Vector2d x =
      base_.PixelOf(static_cast<int>(point / columns), static_cast<int>(point % columns));
  const Eigen::Vector2d pixel = pixels_.data()[i].cast<double>();
  const Eigen::Vector2d offset = x + base_.displacement_px.data()[i] - pixel;
  const Eigen::Matrix2d one = Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d F_base = one + base_.gradient.data()[i].cast<double>();
  const Eigen::Matrix2d F_leg = one + warp.MovedTo(offset).gradient();
  const NoiseBias bias = BiasOf(point, result.leg);
  Eigen::Matrix2d bias_F;
  bias_F << bias.gradient[0], bias.gradient[1], bias.gradient[2], bias.gradient[3];
  total.displacement_px.data()[i] = pixel + warp.Apply(offset) - bias.displacement_px - x;
  total.gradient.data()[i] = ((F_leg - bias_F) * F_base - one).cast<float>();

  // The first image's part of it stays what it was.
  total.reference_share.data()[i] = 0.5F;
  // The legs that end and begin at this image share its noise, but for the offset of their subsets;
  // and each takes its value beside its subset's centre.
  const Eigen::Vector2d before_offset = base_offset_px_.empty()
                                            ? Eigen::Vector2d::Zero().eval()
                                            : base_offset_px_.data()[i].cast<double>().eval();
  const Eigen::Vector2d shift = offset - before_offset;
  const double side = options_.correlator.subset_px;
  const bool linear = options_.correlator.order > 0;
  Eigen::Matrix2d leg = CovarianceOf(result.leg.cov_displacement_px2.data()[i]);
  if (linear) leg += AtOffset(CovarianceOf(result.leg.cov_gradient.data()[i]), offset);
  // The gradients that weigh the noise of one image have the noise of the other: no other leg has
  // this error. H^-1 (n k s^4) H^-1 with L = 2 s^2 H^-1, n pixels.
  const double noise = side * side * noise_of_weights_ / 4;
  const Eigen::Matrix2d second = noise * leg * leg;
  const double flat = (1 - lost_a_px_ * shift.x() * shift.x()) *
                      (1 - lost_a_px_ * shift.y() * shift.y()) *
                      (1 - (linear ? 6 * shift.squaredNorm() / (side * side) : 0));
  const Eigen::Matrix2d before = CovarianceOf(base_.cov_displacement_px2.data()[i]);
  const Eigen::Matrix2d last = CovarianceOf(base_leg_.cov_displacement_px2.data()[i]);
  const Eigen::Matrix2d cov = F_leg * before * F_leg.transpose() + leg + second -
                              flat / 2 * (F_leg * last * F_leg.transpose() + leg);
  result.offset_px.data()[i] = offset.cast<float>();
  result.leg.cov_displacement_px2.data()[i] = TriangleOf(leg);
  total.cov_displacement_px2.data()[i] = TriangleOf(cov);
  if (options_.correlator.order == 0) return;

  // Of G row by row: dG = F_leg dG_base + dG_leg F_base.
  const Eigen::Matrix4d A = Kronecker(F_leg, one);
  const Eigen::Matrix4d B = Kronecker(one, F_base.transpose());
  const Eigen::Matrix4d leg_G = B * CovarianceOf(result.leg.cov_gradient.data()[i]) * B.transpose();
  const Eigen::Matrix4d last_G = A * CovarianceOf(base_leg_.cov_gradient.data()[i]) * A.transpose();
  // Weights that grow linearly to the edge lose three times as much there.
  const Eigen::Vector2d lost = lost_a_px_ * shift.cwiseAbs2();
  const Eigen::Vector2d shared(std::sqrt((1 - 3 * lost.x()) * (1 - lost.y())),
                               std::sqrt((1 - lost.x()) * (1 - 3 * lost.y())));
  const Eigen::Vector4d rho(shared.x(), shared.y(), shared.x(), shared.y());
  const Eigen::Matrix4d second_G = noise * side * side / 12 * leg_G * leg_G;
  const Eigen::Matrix4d cov_G = A * CovarianceOf(base_.cov_gradient.data()[i]) * A.transpose() +
                                leg_G + second_G -
                                rho.asDiagonal() * ((last_G + leg_G) / 2) * rho.asDiagonal();
  total.cov_gradient.data()[i] = TriangleOf(cov_G);
}

}  // namespace plumbline::internal
