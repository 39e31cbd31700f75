#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "calib/image.h"

namespace plumbline::internal {

// SIFT features of an image: places in its own pixels, sorted by row, and one descriptor a row.
struct Features {
  std::vector<Eigen::Vector2d> places_px;
  cv::Mat1f descriptors;
  int factor = 1;  // by which the image was averaged down: places are as much coarser
};

// At most max_features, the strongest of each cell of a grid over the image; averaged down by a
// whole factor first when longer than longest_px. valid: 0 where no feature may lie; may be null.
Features FindFeatures(const GrayImage& image, const Image<std::uint8_t>* valid, int max_features,
                      int longest_px);

struct FeatureMatch {
  std::size_t from = 0, to = 0;
};

// Pairs that are each other's nearest descriptor, and nearer than max_ratio times the second
// nearest in either direction. Sorted by `from`. Exact, so that nothing depends on chance.
std::vector<FeatureMatch> MatchFeatures(const Features& from, const Features& to, double max_ratio);

}  // namespace plumbline::internal
