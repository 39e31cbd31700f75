#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "calib/image.h"
#include "match/correlation_seed.h"

namespace plumbline {

struct FeatureIndexOptions {
  int max_features = 600;        // of each image in the index, spread evenly over it
  int max_query_features = 300;  // of an image that is looked for
  // A feature may be shown by so many images of the index, since their views overlap; it counts
  // where it is nearer than max_ratio times the one after these.
  int overlapping_views = 6;
  double max_ratio = 0.9;
  std::uint64_t random_seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// An image of the index, and the features that it shares with the one that was looked for.
struct IndexMatch {
  std::size_t image = 0;
  // From the image of the index to the other: features that agree with their neighbours in one
  // local affine motion.
  std::vector<CorrelationSeed> agreeing;
};

// Which of many images shows the same surface as another one: SIFT features (Lowe 2004) of all in
// one FLANN index of their descriptors, then local affine RANSAC among those of each image, as in
// FindFeatureSeeds(). Features of a surface that is not there hardly ever agree by chance: at most
// five in tests/match/feature_index_test.cc. Images are averaged down by two for the search.
//
// The nearest descriptors are exact: FLANN's randomised trees differ from run to run.
// Thread-safe; the result does not depend on the number of threads.
class FeatureIndex {
 public:
  // mask: 0 where no feature may lie, of all images of the index; may be null. Throws UsageError
  // from the options, InputError where images have no features at all.
  FeatureIndex(std::span<const GrayImage* const> images, const FeatureIndexOptions& options = {},
               const Image<std::uint8_t>* mask = nullptr);
  ~FeatureIndex();
  FeatureIndex(FeatureIndex&&) noexcept;
  FeatureIndex& operator=(FeatureIndex&&) noexcept;

  std::size_t image_count() const;

  // The images that have features in common with this one, those with the most agreeing ones first.
  [[nodiscard]] std::vector<IndexMatch> Find(const GrayImage& image,
                                             const Image<std::uint8_t>* mask = nullptr) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace plumbline
