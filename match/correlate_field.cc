#include "match/correlate_field.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <mutex>
#include <optional>

#include "calib/error.h"
#include "match/internal/field_parts.h"
#include "match/internal/propagation.h"

namespace plumbline {
namespace {

using internal::Propagation;

// The reference's own place of a point that a backward match should come back to.
constexpr double kSigmas = 5;
// Of the correlation that the match had: what an independent look has to see of it.
constexpr double kSeenAgain = 0.5;

double Bilinear(const GrayImage& image, const Eigen::Vector2d& at) {
  const int x = std::clamp(static_cast<int>(std::floor(at.x())), 0, image.width() - 2);
  const int y = std::clamp(static_cast<int>(std::floor(at.y())), 0, image.height() - 2);
  const double s = at.x() - x;
  const double t = at.y() - y;
  const std::uint16_t* row = image.grey.row(y) + x;
  const std::uint16_t* next = image.grey.row(y + 1) + x;
  return (1 - t) * ((1 - s) * row[0] + s * row[1]) + t * ((1 - s) * next[0] + s * next[1]);
}

// Zero-normalised cross-correlation of the inner half of a subset, by plain bilinear interpolation
// of the raw images: shares nothing with the correlator but the place it found.
double LookAgain(const GrayImage& reference, const GrayImage& deformed,
                 const Eigen::Vector2i& pixel, const SubsetWarp& warp, int radius) {
  double n = 0;
  double f = 0;
  double g = 0;
  double ff = 0;
  double gg = 0;
  double fg = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const Eigen::Vector2i at = pixel + Eigen::Vector2i(x, y);
      if (at.minCoeff() < 0 || at.x() >= reference.width() || at.y() >= reference.height()) {
        continue;
      }
      const double a = reference.grey(at.y(), at.x());
      const double b = Bilinear(deformed, pixel.cast<double>() + warp.Apply(Eigen::Vector2d(x, y)));
      n += 1;
      f += a;
      g += b;
      ff += a * a;
      gg += b * b;
      fg += a * b;
    }
  }
  const double norm = (ff - f * f / n) * (gg - g * g / n);
  return norm > 0 ? (fg - f * g / n) / std::sqrt(norm) : 0;
}

double WorstVariance(const Eigen::Vector3f& cov) {
  return static_cast<double>(cov[0]) + static_cast<double>(cov[2]);
}

}  // namespace

void FieldOptions::Check() const {
  correlator.Check();
  image.Check();
  if (step_px < 1) {
    throw UsageError(fmt::format("The step between points is 1 px or more; {} is not.", step_px));
  }
  if (!(verify_tolerance_px > 0)) {
    throw UsageError("The tolerance of the backward match has to be above 0 px.");
  }
}

struct FieldCorrelator::Impl {
  Impl(const GrayImage& image, const FieldOptions& o, const Image<std::uint8_t>& m)
      : raw(image),
        options(o),
        mask(m),
        reference(image, o.image),
        correlator(reference, o.correlator, mask.empty() ? nullptr : &mask) {}

  PlanarField EmptyField() const;
  const Image<std::uint8_t>* MaskOrNull() const { return mask.empty() ? nullptr : &mask; }
  std::vector<Propagation::Start> StartsOf(const PlanarField& field,
                                           const std::vector<CorrelationSeed>& seeds) const;
  std::vector<CorrelationSeed> SeedsForTheRest(const GrayImage& image,
                                               const PlanarField& field) const;
  void Verify(const GrayImage& image, const CorrelationImage& deformed,
              const Propagation& propagation, CorrelatedField& result) const;
  void JudgeParts(CorrelatedField& result) const;
  void Reject(std::int64_t point, PlanarField& field) const;
  void CheckImage(const GrayImage& image) const;
  CorrelatedField Run(const GrayImage& image, const CorrelationImage& deformed,
                      const std::vector<Propagation::Start>& starts, bool reseed) const;

  GrayImage raw;
  FieldOptions options;
  Image<std::uint8_t> mask;
  CorrelationImage reference;
  SubsetCorrelator correlator;
  std::once_flag neighbours_once;
  NeighbourCorrelation neighbours;
};

FieldCorrelator::FieldCorrelator(const GrayImage& reference, const FieldOptions& options,
                                 const Image<std::uint8_t>& mask) {
  options.Check();
  FieldOptions filled = options;
  if (options.first_px.x() < 0) {
    // A margin for motion of a pixel or two, so that the outermost points do not leave the image.
    const int margin = std::min(
        2, (std::min(reference.width(), reference.height()) - options.correlator.subset_px) / 2);
    const int first = options.correlator.radius_px() + std::max(0, margin);
    const auto count = [&](int length) {
      return length <= 2 * first ? 0 : (length - 2 * first - 1) / options.step_px + 1;
    };
    filled.first_px = Eigen::Vector2i(first, first);
    filled.grid = {count(reference.width()), count(reference.height())};
  }
  impl_ = std::make_unique<Impl>(reference, filled, mask);
  if (filled.grid.width < 1 || filled.grid.height < 1) {
    throw InputError("The region holds no point to correlate: take a larger one.");
  }
  const PlanarField field = impl_->EmptyField();
  if (std::all_of(field.status.values().begin(), field.status.values().end(),
                  [](Status status) { return status == Status::kMasked; })) {
    throw InputError("The mask leaves no point to correlate: it is 0 at every point of the grid.");
  }
}

FieldCorrelator::~FieldCorrelator() = default;
FieldCorrelator::FieldCorrelator(FieldCorrelator&&) noexcept = default;
FieldCorrelator& FieldCorrelator::operator=(FieldCorrelator&&) noexcept = default;

const FieldOptions& FieldCorrelator::options() const { return impl_->options; }

SubsetGrid FieldCorrelator::grid() const {
  const FieldOptions& o = impl_->options;
  return {o.grid,
          o.first_px,
          o.step_px,
          o.correlator.subset_px,
          o.correlator.order,
          o.correlator.shape == SubsetShape::kCircle};
}

const NeighbourCorrelation& FieldCorrelator::neighbours() const {
  std::call_once(impl_->neighbours_once, [&] {
    const CorrelationImage& image = impl_->reference;
    impl_->neighbours = NeighbourCorrelation::OfTexture(
        grid(), {&image.grey(), &image.noise_gradient_x(), &image.noise_gradient_y(), nullptr,
                 impl_->MaskOrNull()});
  });
  return impl_->neighbours;
}

PlanarField FieldCorrelator::Impl::EmptyField() const {
  PlanarField field(options.grid, options.first_px, options.step_px);
  field.subset_px = options.correlator.subset_px;
  field.order = options.correlator.order;
  for (int r = 0; r < options.grid.height; ++r) {
    for (int c = 0; c < options.grid.width; ++c) {
      const Eigen::Vector2i at = field.PixelOf(r, c).cast<int>();
      const bool inside = at.minCoeff() >= 0 && at.x() < raw.width() && at.y() < raw.height();
      if (!inside || (!mask.empty() && mask(at.y(), at.x()) == 0)) {
        field.status(r, c) = Status::kMasked;
      }
    }
  }
  return field;
}

void FieldCorrelator::Impl::CheckImage(const GrayImage& image) const {
  if (image.size() != raw.size()) {
    throw InputError(
        fmt::format("The deformed image has {} x {} px and the reference {} x {}: they have to be "
                    "of one camera and one size.",
                    image.width(), image.height(), raw.width(), raw.height()));
  }
}

// Each seed at the nearest point of the grid.
std::vector<Propagation::Start> FieldCorrelator::Impl::StartsOf(
    const PlanarField& field, const std::vector<CorrelationSeed>& seeds) const {
  std::vector<Propagation::Start> starts;
  for (const CorrelationSeed& seed : seeds) {
    const Eigen::Vector2d place =
        (seed.reference_px - field.first_px.cast<double>()) / field.step_px;
    if (!place.allFinite()) continue;
    const int c = std::clamp(static_cast<int>(std::lround(place.x())), 0, field.size().width - 1);
    const int r = std::clamp(static_cast<int>(std::lround(place.y())), 0, field.size().height - 1);
    const Eigen::Vector2d by = field.PixelOf(r, c) - seed.reference_px;
    if (by.norm() > std::max(field.step_px, options.correlator.subset_px)) continue;
    starts.emplace_back(static_cast<std::int64_t>(r) * field.size().width + c,
                        SubsetWarp::Of(seed.displacement_px, seed.gradient).MovedTo(by));
  }
  return starts;
}

// Seeds for the points that nothing has led to, looked for in these parts of the image alone.
std::vector<CorrelationSeed> FieldCorrelator::Impl::SeedsForTheRest(
    const GrayImage& image, const PlanarField& field) const {
  Image<std::uint8_t> rest(raw.size(), 0);
  std::int64_t count = 0;
  const int reach = std::max(options.step_px, options.correlator.radius_px());
  for (int r = 0; r < field.size().height; ++r) {
    for (int c = 0; c < field.size().width; ++c) {
      const Status status = field.status(r, c);
      if (status == Status::kOk || status == Status::kMasked || status == Status::kLowTexture) {
        continue;
      }
      ++count;
      const Eigen::Vector2i at = field.PixelOf(r, c).cast<int>();
      for (int y = std::max(0, at.y() - reach); y <= std::min(raw.height() - 1, at.y() + reach);
           ++y) {
        std::fill(rest.row(y) + std::max(0, at.x() - reach),
                  rest.row(y) + std::min(raw.width() - 1, at.x() + reach) + 1, std::uint8_t{1});
      }
    }
  }
  // A few points at edges and tears are no region.
  if (count * 200 < static_cast<std::int64_t>(field.status.pixel_count()) || count < 9) return {};
  if (!mask.empty()) {
    for (std::size_t i = 0; i < rest.pixel_count(); ++i) {
      if (mask.data()[i] == 0) rest.data()[i] = 0;
    }
  }
  FindSeedsOptions finer = options.seeds;
  finer.fft.spacing_px = std::max(8, finer.fft.spacing_px / 2);
  return FindSeeds(raw, image, &rest, finer);
}

CorrelatedField FieldCorrelator::Impl::Run(const GrayImage& image, const CorrelationImage& deformed,
                                           const std::vector<Propagation::Start>& starts,
                                           bool reseed) const {
  CorrelatedField result{EmptyField(), {}};
  PlanarField& field = result.field;
  Propagation propagation(correlator, deformed, field);
  propagation.Try(starts);
  propagation.Spread();
  FieldCounts& counts = result.counts;
  const auto ok = [&] {
    return std::count(field.status.values().begin(), field.status.values().end(), Status::kOk);
  };
  if (reseed) {
    const std::int64_t before = ok();
    const std::vector<Propagation::Start> more = StartsOf(field, SeedsForTheRest(image, field));
    propagation.Try(more);
    propagation.Spread();
    counts.reseeded = ok() - before;
  }
  counts.seeds = static_cast<std::int64_t>(starts.size());
  if (options.verify) {
    Verify(image, deformed, propagation, result);
    JudgeParts(result);
  }
  for (std::size_t i = 0; i < field.status.pixel_count(); ++i) {
    const Status status = field.status.data()[i];
    ++counts.points;
    ++counts.by_status[static_cast<std::size_t>(status)];
    counts.attempted += status != Status::kMasked ? 1 : 0;
    counts.ok += status == Status::kOk ? 1 : 0;
  }
  return result;
}

void FieldCorrelator::Impl::Reject(std::int64_t point, PlanarField& field) const {
  const auto i = static_cast<std::size_t>(point);
  const PlanarField none({1, 1}, {0, 0}, 1);
  field.status.data()[i] = Status::kFailedVerification;
  field.displacement_px.data()[i] = none.displacement_px(0, 0);
  field.gradient.data()[i] = none.gradient(0, 0);
  field.cov_displacement_px2.data()[i] = none.cov_displacement_px2(0, 0);
  field.cov_gradient.data()[i] = none.cov_gradient(0, 0);
}

void FieldCorrelator::Impl::Verify(const GrayImage& image, const CorrelationImage& deformed,
                                   const Propagation& propagation, CorrelatedField& result) const {
  PlanarField& field = result.field;
  CorrelatorOptions backward_options = options.correlator;
  backward_options.max_sigma_px = 1;  // the forward match has been judged already
  const SubsetCorrelator backward(deformed, backward_options);
  std::vector<std::uint8_t> rejected(field.status.pixel_count(), 0);
  tbb::parallel_for(std::size_t{0}, rejected.size(), [&](std::size_t i) {
    if (field.status.data()[i] != Status::kOk) return;
    const Eigen::Vector2i pixel = propagation.PixelOf(static_cast<std::int64_t>(i));
    SubsetWarp warp;
    warp.c = propagation.WarpOf(static_cast<std::int64_t>(i)).cast<double>();
    warp.c.col(0) = field.displacement_px.data()[i];
    if (LookAgain(raw, image, pixel, warp, options.correlator.radius_px() / 2) <
        kSeenAgain * static_cast<double>(field.zncc.data()[i])) {
      rejected[i] = 1;
      return;
    }
    const Eigen::Vector2d there = pixel.cast<double>() + warp.displacement_px();
    const Eigen::Vector2i from = there.array().round().cast<int>();
    const SubsetWarp start = Inverse(warp).MovedTo((from - pixel).cast<double>());
    const SubsetMatch back = backward.Match(reference, from, start);
    // At the border of the image there may not be enough of the subset to come back with.
    if (back.status == Status::kOutsideImage) return;
    const Eigen::Vector2d home = from.cast<double>() + back.warp.Apply(there - from.cast<double>());
    const double sigma = std::sqrt(WorstVariance(field.cov_displacement_px2.data()[i]));
    const bool found =
        back.status == Status::kOk &&
        (home - pixel.cast<double>()).norm() <= options.verify_tolerance_px + kSigmas * sigma;
    if (!found) rejected[i] = 1;
  });
  for (std::size_t i = 0; i < rejected.size(); ++i) {
    if (rejected[i] == 0) continue;
    Reject(static_cast<std::int64_t>(i), field);
    ++result.counts.not_found_back;
  }
}

void FieldCorrelator::Impl::JudgeParts(CorrelatedField& result) const {
  const std::vector<internal::FieldPart> parts = internal::PartsOf(result.field);
  const std::vector<std::size_t> isolated = internal::IsolatedParts(parts, result.field);
  const auto reject = [&](const std::vector<std::size_t>& which, std::int64_t& count) {
    for (const std::size_t part : which) {
      for (const std::int64_t point : parts[part].points) {
        if (result.field.status.data()[point] != Status::kOk) continue;
        Reject(point, result.field);
        ++count;
      }
    }
  };
  reject(isolated, result.counts.isolated);
  if (!options.keep_still_parts) reject(internal::StillBackground(parts), result.counts.still);
}

CorrelatedField FieldCorrelator::Correlate(const GrayImage& deformed,
                                           const PlanarField* prior) const {
  const Impl& impl = *impl_;
  impl.CheckImage(deformed);
  if (prior == nullptr) {
    return CorrelateFrom(deformed,
                         FindSeeds(impl.raw, deformed, impl.MaskOrNull(), impl.options.seeds));
  }
  if (prior->size() != impl.options.grid) {
    throw InputError("The field to start from is of another grid than this one.");
  }
  std::vector<internal::Propagation::Start> starts;
  for (std::size_t i = 0; i < prior->status.pixel_count(); ++i) {
    if (prior->status.data()[i] != Status::kOk) continue;
    const SubsetWarp warp =
        SubsetWarp::Of(prior->displacement_px.data()[i], prior->gradient.data()[i].cast<double>());
    if (warp.c.allFinite()) starts.emplace_back(static_cast<std::int64_t>(i), warp);
  }
  const CorrelationImage prepared(deformed, impl.options.image);
  CorrelatedField result = impl.Run(deformed, prepared, starts, false);
  // A jump of the specimen leaves nothing of a start from the frame before.
  if (result.counts.ok * 2 < static_cast<std::int64_t>(starts.size())) {
    return CorrelateFrom(deformed,
                         FindSeeds(impl.raw, deformed, impl.MaskOrNull(), impl.options.seeds));
  }
  return result;
}

CorrelatedField FieldCorrelator::CorrelateFrom(const GrayImage& deformed,
                                               const std::vector<CorrelationSeed>& seeds) const {
  impl_->CheckImage(deformed);
  const CorrelationImage prepared(deformed, impl_->options.image);
  return impl_->Run(deformed, prepared, impl_->StartsOf(impl_->EmptyField(), seeds), true);
}

}  // namespace plumbline
