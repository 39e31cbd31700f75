#pragma once

#include <cstdint>
#include <vector>

#include "calib/image.h"
#include "match/correlation_seed.h"

namespace plumbline {

struct FeatureSeedOptions {
  int max_features = 2000;       // of each image, spread evenly over it
  double max_ratio = 0.85;       // of the distances to the best and the second best descriptor
  int spacing_px = 50;           // at most one seed in a cell of this side
  int subset_px = 41;            // odd side of the subset on which each seed is verified
  double min_zncc = 0.6;         // of that subset, moved and strained as the seed says
  double min_contrast_grey = 1;  // its smallest standard deviation, in grey levels of 8 bits
  std::uint64_t random_seed = 1;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Finds the motion between two images by features, however far and however much they turned, and
// for strains of some 20 %: SIFT (Lowe, "Distinctive image features from scale-invariant
// keypoints", IJCV 2004), matched both ways by descriptor with the ratio test, then local affine
// RANSAC, in which a match needs a few of its neighbours to move under one affine map with it.
// Parts that move differently keep their own motion. Each seed is verified and centred on the grey
// values themselves: the reference subset against the deformed one, moved and strained as the seed
// says.
//
// Images longer than 800 px are averaged down for the search of features, not for the
// verification. The nearest descriptors are exact: FLANN's randomised trees differ from run to run.
//
// mask: 0 where a pixel of the reference is not to be used; may be null.
// Returns: seeds at the full resolution, sorted by place; score is the ZNCC. Where fewer than a
//          handful of neighbours agree, nothing.
// Throws:  UsageError from options.Check(); InputError when the images or the mask differ in size
//          or the subset does not fit into them.
// The result does not depend on the number of threads.
[[nodiscard]] std::vector<CorrelationSeed> FindFeatureSeeds(
    const GrayImage& reference, const GrayImage& deformed,
    const Image<std::uint8_t>* mask = nullptr, const FeatureSeedOptions& options = {});

}  // namespace plumbline
