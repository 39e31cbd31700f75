#pragma once

#include <cstddef>

#include "calib/image.h"
#include "match/stereo_sequence.h"
#include "track/rolling_survey.h"
#include "track/wheel_reference.h"

namespace plumbline::internal {

// Throws InputError where the images are not of the size of the wheel's.
void CheckSize(const WheelReference& wheel, const GrayImage& left, const GrayImage& right);

// The view of which most of what a frame at this angle shows is in the picture.
std::size_t NearestView(const WheelReference& wheel, double angle_rad);

// So many of the points of a grid, along rows and columns, that at most `most` are left.
int StrideFor(int points, int most);

// Every `stride`-th value along rows and columns, from the first one on.
template <typename T>
Image<T> EveryOf(const Image<T>& image, int stride) {
  if (image.empty()) return {};
  Image<T> out({(image.width() - 1) / stride + 1, (image.height() - 1) / stride + 1},
               image.values().front());
  for (int r = 0; r < out.height(); ++r) {
    for (int c = 0; c < out.width(); ++c) out(r, c) = image(r * stride, c * stride);
  }
  return out;
}

// The points of every `stride`-th row and column, where both images were matched, RoundAsStored().
StereoField EveryMatch(const StereoField& field, int stride);

// How many points of a grid share one noise, by how their subsets overlap.
double AlikePoints(const PlanarField& grid, const CorrelatorOptions& correlator);

// Only points that may be kept are matched, as far as they are near enough, half a subset, for
// neighbours to lead to each other.
RollingSurveyOptions Coarser(RollingSurveyOptions options, ImageSize image);

}  // namespace plumbline::internal
