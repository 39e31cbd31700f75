#include "match/feature_index.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <flann/flann.hpp>
#include <opencv2/core.hpp>
#include <utility>

#include "calib/error.h"
#include "match/internal/feature_match.h"
#include "match/internal/seed_consistency.h"

namespace plumbline {
namespace {

// Features are looked for in images averaged down by two: a quarter of the time, and of a speckle
// what is left tells as much.
int LongestPx(const GrayImage& image) { return (std::max(image.width(), image.height()) + 1) / 2; }
constexpr double kTolerancePx = 1.5;

// Features of several orientations at one place would bear each other out.
bool IsAmongLast(const std::vector<CorrelationSeed>& seeds, const CorrelationSeed& seed) {
  const auto recent = seeds.end() - std::min<std::ptrdiff_t>(seeds.end() - seeds.begin(), 20);
  return std::any_of(recent, seeds.end(), [&](const CorrelationSeed& other) {
    return (other.reference_px - seed.reference_px).norm() < 1 &&
           (other.displacement_px - seed.displacement_px).norm() < 1;
  });
}

}  // namespace

void FeatureIndexOptions::Check() const {
  if (max_features < 10 || max_query_features < 10) {
    throw UsageError("feature index: at least 10 features an image");
  }
  if (overlapping_views < 1) throw UsageError("feature index: overlapping_views is 1 or more");
  if (!(max_ratio > 0 && max_ratio <= 1)) {
    throw UsageError("feature index: max_ratio lies between 0 and 1");
  }
}

struct FeatureIndex::Impl {
  struct Place {
    std::size_t image = 0;
    Eigen::Vector2d px;
  };
  using Index = flann::KDTreeSingleIndex<flann::L2<float>>;

  FeatureIndexOptions options;
  std::size_t images = 0;
  double reach_px = 0;  // of neighbours that have a say
  std::vector<Place> places;
  cv::Mat1f descriptors;
  std::unique_ptr<Index> index;
};

FeatureIndex::FeatureIndex(std::span<const GrayImage* const> images,
                           const FeatureIndexOptions& options, const Image<std::uint8_t>* mask) {
  options.Check();
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  impl->images = images.size();
  std::vector<internal::Features> found(images.size());
  tbb::parallel_for(std::size_t{0}, images.size(), [&](std::size_t i) {
    found[i] =
        internal::FindFeatures(*images[i], mask, options.max_features, LongestPx(*images[i]));
  });
  for (std::size_t i = 0; i < images.size(); ++i) {
    // All of the image: a vote without neighbours would pass for want of contradiction.
    impl->reach_px = std::max(impl->reach_px, std::hypot(images[i]->width(), images[i]->height()));
    for (const Eigen::Vector2d& px : found[i].places_px) impl->places.push_back({i, px});
    if (!found[i].places_px.empty()) impl->descriptors.push_back(found[i].descriptors);
  }
  if (impl->places.size() < 2) {
    throw InputError("feature index: the images show no features to tell them by");
  }
  constexpr int kLeaf = 20;
  impl->index = std::make_unique<Impl::Index>(
      flann::Matrix<float>(impl->descriptors.ptr<float>(),
                           static_cast<std::size_t>(impl->descriptors.rows),
                           static_cast<std::size_t>(impl->descriptors.cols)),
      flann::KDTreeSingleIndexParams(kLeaf));
  impl->index->buildIndex();
  impl_ = std::move(impl);
}

FeatureIndex::~FeatureIndex() = default;
FeatureIndex::FeatureIndex(FeatureIndex&&) noexcept = default;
FeatureIndex& FeatureIndex::operator=(FeatureIndex&&) noexcept = default;

std::size_t FeatureIndex::image_count() const { return impl_->images; }

std::vector<IndexMatch> FeatureIndex::Find(const GrayImage& image,
                                           const Image<std::uint8_t>* mask) const {
  const Impl& impl = *impl_;
  internal::Features query =
      internal::FindFeatures(image, mask, impl.options.max_query_features, LongestPx(image));
  const auto count = static_cast<std::size_t>(query.descriptors.rows);
  const std::size_t nearest =
      std::min(static_cast<std::size_t>(impl.options.overlapping_views) + 1, impl.places.size());
  std::vector<std::vector<std::size_t>> indices(count);
  std::vector<std::vector<float>> squared(count);
  tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
    std::vector<std::vector<std::size_t>> which;
    std::vector<std::vector<float>> distance2;
    flann::Matrix<float> one(query.descriptors.ptr<float>(static_cast<int>(i)), 1,
                             static_cast<std::size_t>(query.descriptors.cols));
    impl.index->knnSearch(one, which, distance2, nearest,
                          flann::SearchParams(flann::FLANN_CHECKS_UNLIMITED));
    indices[i] = std::move(which[0]);
    squared[i] = std::move(distance2[0]);
  });
  std::vector<std::vector<CorrelationSeed>> votes(impl.images);
  const auto ratio2 = static_cast<float>(impl.options.max_ratio * impl.options.max_ratio);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t n = 0; n + 1 < indices[i].size(); ++n) {
      if (!(squared[i][n] < ratio2 * squared[i].back())) break;
      const Impl::Place& place = impl.places[indices[i][n]];
      CorrelationSeed seed;
      seed.reference_px = place.px;
      seed.displacement_px = query.places_px[i] - place.px;
      if (!IsAmongLast(votes[place.image], seed)) votes[place.image].push_back(seed);
    }
  }
  internal::ConsistencyOptions consistency;
  consistency.neighbours = 16;
  consistency.least_support = 5;
  consistency.draws = 80;
  consistency.random_seed = impl.options.random_seed;
  consistency.tolerance_px = kTolerancePx * query.factor;
  consistency.reach_px = impl.reach_px;
  std::vector<IndexMatch> matches(impl.images);
  tbb::parallel_for(std::size_t{0}, impl.images, [&](std::size_t v) {
    matches[v].image = v;
    // With hardly any neighbours nothing would be left to contradict.
    constexpr std::size_t kFew = 8;
    if (votes[v].size() >= kFew) {
      matches[v].agreeing = internal::KeepConsistent(votes[v], consistency);
    }
  });
  std::erase_if(matches, [](const IndexMatch& m) { return m.agreeing.empty(); });
  std::stable_sort(matches.begin(), matches.end(), [](const IndexMatch& a, const IndexMatch& b) {
    return a.agreeing.size() > b.agreeing.size();
  });
  return matches;
}

}  // namespace plumbline
