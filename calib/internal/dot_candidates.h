#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "calib/internal/disc_fit.h"

namespace plumbline::internal {

// Something in a photograph that may be a dot, before any board has been made out of it.
struct DotCandidate {
  Ellipse ellipse;      // good to about a pixel
  double contrast = 0;  // grey levels of the 8-bit image between surroundings and dot
  bool ring = false;    // bright in the middle
};

struct DotCandidates {
  std::vector<DotCandidate> dots;  // sorted by x, then y
  int clipped = 0;                 // dot-like blobs that touch the edge of the image
};

// Elliptic blobs darker (dark = true) or brighter than their surroundings in a CV_8UC1 image.
// Thresholds against local means at three scales, so that neither shading nor vignetting hides
// dots; radius from about 2.5 px to a tenth of the image's height.
DotCandidates FindDotCandidates(const cv::Mat& image, bool dark);

}  // namespace plumbline::internal
