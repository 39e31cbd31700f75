#include "match/correlate_field.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <mutex>
#include <optional>

#include "calib/error.h"
#include "match/internal/propagation.h"
#include "match/internal/verify_field.h"

namespace plumbline {
namespace {

using internal::Propagation;

constexpr int kSmallestSeedSubset = 9;  // px, of FftSeedOptions and FeatureSeedOptions
// Share of the points that the frame before knew which it has to lead to; else it was no good
// start.
constexpr double kFewAstray = 0.9;
// Points whose subsets' equations are kept: 400 MB.
constexpr std::size_t kMostRemembered = 200'000;

}  // namespace

void FieldOptions::Check() const {
  correlator.Check();
  image.Check();
  seeds.Check();
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
  void RememberPoints(const PlanarField& field);
  const Image<std::uint8_t>* MaskOrNull() const { return mask.empty() ? nullptr : &mask; }
  std::vector<Propagation::Start> StartsOf(const PlanarField& field,
                                           const std::vector<CorrelationSeed>& seeds) const;
  std::vector<Propagation::Start> Sparse(const std::vector<Propagation::Start>& starts) const;
  std::vector<CorrelationSeed> SeedsForTheRest(const GrayImage& image,
                                               const PlanarField& field) const;
  void CheckImage(const GrayImage& image) const;
  CorrelatedField Run(const GrayImage& image, const CorrelationImage& deformed,
                      const std::vector<Propagation::Start>& starts, const FieldStart& start,
                      bool from_seeds) const;
  CorrelatedField FromSeeds(const GrayImage& image, const CorrelationImage& deformed,
                            const FieldStart& start) const;

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
  // Seeds are looked for with subsets that have room to move in a small image too.
  const int shorter = std::min(reference.width(), reference.height());
  const int widest = std::max(kSmallestSeedSubset, shorter / 3 * 2 + 1);
  filled.seeds.fft.subset_px = std::min(filled.seeds.fft.subset_px, widest);
  filled.seeds.features.subset_px = std::min(filled.seeds.features.subset_px, widest);
  impl_ = std::make_unique<Impl>(reference, filled, mask);
  if (options.first_px.x() < 0) {
    // Room for motion of a pixel or two, so that the outermost points do not leave the image.
    const int room =
        std::min(impl_->reference.edge_px() + 2, (shorter - options.correlator.subset_px) / 2);
    const int first = options.correlator.radius_px() + std::max(0, room);
    const auto count = [&](int length) {
      return length <= 2 * first ? 0 : (length - 2 * first - 1) / options.step_px + 1;
    };
    filled.first_px = Eigen::Vector2i(first, first);
    filled.grid = {count(reference.width()), count(reference.height())};
    impl_->options = filled;
  }
  if (filled.grid.width < 1 || filled.grid.height < 1) {
    throw InputError("The region holds no point to correlate: take a larger one.");
  }
  const PlanarField field = impl_->EmptyField();
  if (field.status.pixel_count() <= kMostRemembered) impl_->RememberPoints(field);
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

void FieldCorrelator::Impl::RememberPoints(const PlanarField& field) {
  std::vector<Eigen::Vector2i> pixels;
  for (int r = 0; r < options.grid.height; ++r) {
    for (int c = 0; c < options.grid.width; ++c) {
      if (field.status(r, c) != Status::kMasked) pixels.push_back(field.PixelOf(r, c).cast<int>());
    }
  }
  correlator.Remember(pixels);
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

// One a subset's side. Points between them are better led to by their neighbours, who know how
// subsets are bent, than by starts of first order, which leave a trace within the last step.
std::vector<Propagation::Start> FieldCorrelator::Impl::Sparse(
    const std::vector<Propagation::Start>& starts) const {
  const int apart = std::max(2, options.correlator.subset_px / options.step_px);
  std::vector<Propagation::Start> some;
  for (const Propagation::Start& start : starts) {
    const auto r = start.first / options.grid.width, c = start.first % options.grid.width;
    if (r % apart == 0 && c % apart == 0) some.push_back(start);
  }
  return some;
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
                                           const FieldStart& start, bool from_seeds) const {
  CorrelatedField result{EmptyField(), {}};
  PlanarField& field = result.field;
  Propagation propagation(correlator, deformed, field, nullptr, start.curvature);
  if (!start.search) {
    propagation.Try(Sparse(starts));
    propagation.Spread();
  }
  propagation.Try(starts);
  propagation.Spread();
  FieldCounts& counts = result.counts;
  const auto ok = [&] {
    return std::count(field.status.values().begin(), field.status.values().end(), Status::kOk);
  };
  const bool led_astray =
      static_cast<double>(ok()) < kFewAstray * static_cast<double>(starts.size());
  if (from_seeds || (led_astray && start.search)) {
    const std::int64_t before = ok();
    const bool own = !from_seeds && start.seeds;
    propagation.TryAgain();
    propagation.Try(StartsOf(field, own ? start.seeds(image) : SeedsForTheRest(image, field)));
    propagation.Spread();
    counts.reseeded = ok() - before;
  }
  counts.seeds = static_cast<std::int64_t>(starts.size());
  if (options.verify) {
    if (from_seeds || counts.reseeded > 0 || start.verify_back) {
      internal::RejectNotFoundBack({raw, reference, image, deformed, MaskOrNull()}, options,
                                   propagation, field, counts);
    }
    internal::RejectParts(options.keep_still_parts, field, counts);
  }
  internal::CountStatuses(field, counts);
  return result;
}

CorrelatedField FieldCorrelator::Impl::FromSeeds(const GrayImage& image,
                                                 const CorrelationImage& deformed,
                                                 const FieldStart& start) const {
  const std::vector<CorrelationSeed> seeds =
      start.seeds ? start.seeds(image) : FindSeeds(raw, image, MaskOrNull(), options.seeds);
  return Run(image, deformed, StartsOf(EmptyField(), seeds), start, true);
}

CorrelatedField FieldCorrelator::Correlate(const GrayImage& deformed,
                                           const FieldStart& start) const {
  const Impl& impl = *impl_;
  impl.CheckImage(deformed);
  const CorrelationImage prepared(deformed, impl.options.image);
  if (start.prior == nullptr) return impl.FromSeeds(deformed, prepared, start);
  const PlanarField& prior = *start.prior;
  if (prior.size() != impl.options.grid) {
    throw InputError("The field to start from is of another grid than this one.");
  }
  std::vector<internal::Propagation::Start> starts;
  for (std::size_t i = 0; i < prior.status.pixel_count(); ++i) {
    if (prior.status.data()[i] != Status::kOk) continue;
    const SubsetWarp warp =
        SubsetWarp::Of(prior.displacement_px.data()[i], prior.gradient.data()[i].cast<double>());
    if (warp.c.allFinite()) starts.emplace_back(static_cast<std::int64_t>(i), warp);
  }
  CorrelatedField result = impl.Run(deformed, prepared, starts, start, false);
  // A jump of the specimen leaves nothing of a start from the frame before.
  if (!start.search ||
      (result.counts.ok * 2 >= static_cast<std::int64_t>(starts.size()) && result.counts.ok > 0)) {
    return result;
  }
  CorrelatedField anew = impl.FromSeeds(deformed, prepared, start);
  return anew.counts.ok > result.counts.ok ? anew : result;
}

CorrelatedField FieldCorrelator::CorrelateFrom(const GrayImage& deformed,
                                               const std::vector<CorrelationSeed>& seeds) const {
  return Correlate(deformed, {.seeds = [&](const GrayImage&) { return seeds; }});
}

}  // namespace plumbline
