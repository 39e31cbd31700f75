#include "match/internal/reference_subsets.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>

namespace plumbline::internal {
namespace {

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

SubsetOutline OutlineOf(const CorrelatorOptions& options) {
  return options.shape == SubsetShape::kCircle ? SubsetOutline::Circle(options.radius_px())
                                               : SubsetOutline::Square(options.radius_px());
}

std::int64_t KeyOf(const Eigen::Vector2i& pixel) {
  return (static_cast<std::int64_t>(pixel.y()) << 32) + pixel.x();
}

}  // namespace

ReferenceSubsets::ReferenceSubsets(const CorrelationImage& reference,
                                   const CorrelatorOptions& options,
                                   const Image<std::uint8_t>* mask)
    : reference_(reference),
      options_(options),
      mask_(mask),
      outline_(OutlineOf(options)),
      filtered_(reference.options().prefilter != Prefilter::kNone) {
  for (std::size_t i = 0; i < outline_.begin.size(); ++i) {
    full_count_ += outline_.end[i] - outline_.begin[i];
  }
  if (mask != nullptr) pixels_used_ = Eroded(*mask, reference.edge_px());
  planes_ = {&reference.grey(),
             &reference.gradient_x(),
             &reference.gradient_y(),
             filtered_ ? &reference.noise_gradient_x() : nullptr,
             filtered_ ? &reference.noise_gradient_y() : nullptr,
             mask != nullptr ? &pixels_used_ : nullptr,
             reference.edge_px()};
}

// Pixels of a subset that lie in the image and the mask.
int ReferenceSubsets::CountInside(const Eigen::Vector2i& pixel) const {
  const ImageSize size = reference_.size();
  int count = 0;
  for (std::size_t i = 0; i < outline_.begin.size(); ++i) {
    const int y = pixel.y() + static_cast<int>(i) - outline_.radius;
    if (y < 0 || y >= size.height) continue;
    const int first = std::max(0, pixel.x() + outline_.begin[i]);
    const int last = std::min(size.width, pixel.x() + outline_.end[i]);
    if (mask_ == nullptr) {
      count += std::max(0, last - first);
    } else {
      const std::uint8_t* row = mask_->row(y);
      for (int x = first; x < last; ++x) count += row[x] != 0 ? 1 : 0;
    }
  }
  return count;
}

// Whether a subset with so many pixels to use can be looked for.
Status ReferenceSubsets::Examine(const Eigen::Vector2i& pixel, int count) const {
  const int unknowns = 2 * kShapeTerms[options_.order] + 2;
  if (count >= 2 * unknowns && CountInside(pixel) >= options_.min_pixel_share * full_count_) {
    return Status::kOk;
  }
  const ImageSize size = reference_.size();
  const Eigen::Vector2i last(size.width - 1, size.height - 1);
  const int r = options_.radius_px();
  const bool inside = (pixel.array() - r).minCoeff() >= 0 && (last - pixel).minCoeff() >= r;
  return inside ? Status::kMasked : Status::kOutsideImage;
}

void ReferenceSubsets::WorkOut(const PackedSubset& pixels, Facts& facts) const {
  const int order = options_.order;
  facts.equations =
      NormalEquations(order, facts.count, SumReference(pixels, order),
                      SumProducts(pixels, pixels.gradient_x, pixels.gradient_y, order));
  if (!facts.equations.solvable()) return;
  if (!filtered_) {
    facts.covariance_per_variance = facts.equations.CovariancePerVariance(nullptr);
    return;
  }
  const ProductSums noise = SumProducts(pixels, pixels.noise_x, pixels.noise_y, order);
  facts.covariance_per_variance = facts.equations.CovariancePerVariance(&noise);
}

void ReferenceSubsets::Take(const Eigen::Vector2i& pixel, Subset& subset) const {
  const auto known = place_.find(KeyOf(pixel));
  const bool remembered = known != place_.end();
  subset.facts = remembered ? &facts_[known->second] : &subset.own;
  if (remembered && subset.facts->status != Status::kOk) return;
  const ImageSize size = reference_.size();
  Facts& own = subset.own;
  own.status = Status::kOk;
  if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() >= size.width || pixel.y() >= size.height) {
    own.status = Status::kOutsideImage;
    return;
  }
  if (mask_ != nullptr && (*mask_)(pixel.y(), pixel.x()) == 0) {
    own.status = Status::kMasked;
    return;
  }
  const int r = options_.radius_px();
  const int edge = reference_.edge_px();
  const Eigen::Vector2i last(size.width - 1, size.height - 1);
  subset.low = (Eigen::Vector2i::Constant(edge) - pixel).cwiseMax(-r).cast<double>();
  subset.high = (last - Eigen::Vector2i::Constant(edge) - pixel).cwiseMin(r).cast<double>();
  subset.offset = reference_.grey()(pixel.y(), pixel.x());
  ReferencePlanes planes = planes_;
  if (remembered) {
    planes.noise_x = planes.noise_y = nullptr;
    if (subset.facts->count == full_count_) planes.mask = nullptr;
  }
  const int count = Pack(planes, outline_, pixel.x(), pixel.y(), subset.offset, subset.pixels);
  if (remembered) return;
  own.count = count;
  own.status = Examine(pixel, count);
  if (own.status == Status::kOk) WorkOut(subset.pixels, own);
}

void ReferenceSubsets::Remember(const std::vector<Eigen::Vector2i>& pixels) {
  place_.clear();
  std::vector<Facts> facts(pixels.size());
  tbb::parallel_for(std::size_t{0}, pixels.size(), [&](std::size_t i) {
    static thread_local Subset subset;
    Take(pixels[i], subset);
    facts[i] = subset.own;
  });
  facts_ = std::move(facts);
  for (std::size_t i = 0; i < pixels.size(); ++i) place_.emplace(KeyOf(pixels[i]), i);
}

}  // namespace plumbline::internal
