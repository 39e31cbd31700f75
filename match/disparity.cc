#include "match/disparity.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>

#include "calib/error.h"
#include "match/internal/dense_match.h"
#include "match/internal/disparity_range.h"
#include "match/internal/disparity_sigma.h"
#include "match/internal/refine_disparity.h"

namespace plumbline {
namespace {

using internal::DisparityRange;
using internal::RefinedDisparity;
using internal::RefineOutcome;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// A blob of fewer pixels, cut off from its surroundings by a step of more than 1 px, is no surface.
constexpr int kSmallestPatchPx = 200;
constexpr double kPatchStepPx = 1;
// Windows correlating less than this are unlike, whatever the matcher says ...
constexpr float kLeastCorrelation = 0.7F;
// ... and where the grey values decide less than this share of the value, there is no texture.
constexpr float kLeastDataShare = 0.3F;
constexpr int kLargestDisparityCount = 2032;  // OpenCV keeps 16 steps a px in 16 bits

void CheckPair(const GrayImage& left, const GrayImage& right, const DisparityOptions& options,
               const Image<std::uint8_t>* left_valid, const Image<std::uint8_t>* right_valid) {
  if (left.size() != right.size()) {
    throw InputError(
        fmt::format("the left image is {}x{} and the right one {}x{}: disparity needs a rectified "
                    "pair of one size",
                    left.width(), left.height(), right.width(), right.height()));
  }
  const int window =
      std::max({internal::BlockPx(options), 2 * options.refinement_radius_px + 1, 16});
  if (left.width() < window || left.height() < window) {
    throw InputError(
        fmt::format("the images are {}x{}, smaller than the {}x{} px that matching needs: "
                    "give larger images or smaller windows",
                    left.width(), left.height(), window, window));
  }
  for (const auto* valid : {left_valid, right_valid}) {
    if (valid != nullptr && valid->size() != left.size()) {
      throw InputError(fmt::format("a mask is {}x{} for images of {}x{}: give one of their size",
                                   valid->width(), valid->height(), left.width(), left.height()));
    }
  }
}

DisparityRange ChooseRange(const cv::Mat1b& left, const cv::Mat1b& right,
                           const DisparityOptions& options, const Image<std::uint8_t>* left_valid,
                           const Image<std::uint8_t>* right_valid) {
  DisparityRange range;
  if (options.min_disparity_px) {
    range.minimum_px = *options.min_disparity_px;
    range.count = *options.max_disparity_px - *options.min_disparity_px + 1;
    if (range.minimum_px >= left.cols || range.minimum_px + range.count <= -left.cols) {
      throw InputError(
          fmt::format("disparities {} to {} px move every pixel of a {} px wide image out of the "
                      "other: check the "
                      "range",
                      *options.min_disparity_px, *options.max_disparity_px, left.cols));
    }
    return range;
  }
  range = internal::FindDisparityRange(left, right, left_valid, right_valid);
  if (range.count == 0) {
    throw InputError(
        "no disparity range could be found, too few textured patches of the left image have a "
        "clear "
        "match on the same row of the right one: check that the pair is rectified and shows the "
        "same "
        "surface, or give the least and largest disparity");
  }
  if (range.count > kLargestDisparityCount) {
    throw InputError(
        fmt::format("the pair shows disparities from {} to {} px, more than the {} that can "
                    "be searched at once: give a range or smaller images",
                    range.minimum_px, range.minimum_px + range.count - 1, kLargestDisparityCount));
  }
  return range;
}

bool IsMasked(const Image<std::uint8_t>* valid, int x, int y) {
  return valid != nullptr && (*valid)(y, x) == 0;
}

// The matcher's disparities in px where both directions agree; else NaN and the reason.
Image<float> CheckedStart(const cv::Mat1s& from_left, const cv::Mat1s& from_right,
                          const DisparityRange& range, double tolerance_px,
                          const Image<std::uint8_t>* left_valid,
                          const Image<std::uint8_t>* right_valid, DisparityMap* map) {
  const int width = from_left.cols;
  Image<float> start({width, from_left.rows}, kNaN);
  for (int y = 0; y < from_left.rows; ++y) {
    for (int x = 0; x < width; ++x) {
      Status& status = map->status(y, x);
      const double steps = from_left(y, x);
      const double d = range.minimum_px + steps / 16;
      const int there = static_cast<int>(std::lround(x - d));
      if (IsMasked(left_valid, x, y)) {
        status = Status::kMasked;
      } else if (steps < 0) {
        status = x - range.minimum_px < 0 || x - (range.minimum_px + range.count - 1) >= width
                     ? Status::kOutsideImage
                     : Status::kLowCorrelation;
      } else if (there < 0 || there >= width) {
        status = Status::kOutsideImage;
      } else if (IsMasked(right_valid, there, y)) {
        status = Status::kMasked;
      } else if (from_right(y, there) < 0 ||
                 std::abs(from_right(y, there) - steps) > 16 * tolerance_px) {
        status = Status::kOccluded;
      } else {
        start(y, x) = static_cast<float>(d);
      }
    }
  }
  return start;
}

// Drops small isolated patches, which agree left to right by chance (repeated texture).
void DropSmallPatches(const DisparityRange& range, DisparityMap* map) {
  const Image<float>& value = map->value_px;
  cv::Mat1s steps(value.height(), value.width());
  constexpr short kNone = -32000;
  const auto base = static_cast<float>(range.minimum_px);
  for (int y = 0; y < steps.rows; ++y) {
    for (int x = 0; x < steps.cols; ++x) {
      steps(y, x) = map->status(y, x) == Status::kOk
                        ? cv::saturate_cast<short>(16 * (value(y, x) - base))
                        : kNone;
    }
  }
  cv::filterSpeckles(steps, kNone, kSmallestPatchPx, 16 * kPatchStepPx);
  for (int y = 0; y < steps.rows; ++y) {
    for (int x = 0; x < steps.cols; ++x) {
      if (steps(y, x) != kNone || map->status(y, x) != Status::kOk) continue;
      map->value_px(y, x) = map->sigma_px(y, x) = kNaN;
      map->status(y, x) = Status::kFailedVerification;
    }
  }
}

void Deliver(const RefinedDisparity& refined, const Image<float>& sigma, DisparityMap* map) {
  for (int y = 0; y < sigma.height(); ++y) {
    for (int x = 0; x < sigma.width(); ++x) {
      const RefineOutcome outcome = refined.outcome(y, x);
      if (outcome == RefineOutcome::kNone) continue;
      Status& status = map->status(y, x);
      if (outcome == RefineOutcome::kTextureless || refined.data_share(y, x) < kLeastDataShare) {
        status = Status::kLowTexture;
      } else if (refined.correlation(y, x) < kLeastCorrelation) {
        status = Status::kLowCorrelation;
      } else if (!std::isfinite(sigma(y, x))) {
        status = Status::kFailedVerification;
      } else {
        map->value_px(y, x) = refined.value_px(y, x);
        map->sigma_px(y, x) = sigma(y, x);
      }
    }
  }
}

}  // namespace

void DisparityOptions::Check() const {
  if (min_disparity_px.has_value() != max_disparity_px.has_value()) {
    throw UsageError(
        "only one end of the disparity range is given: give both the least and the largest, or "
        "neither to have it found");
  }
  if (min_disparity_px && *max_disparity_px < *min_disparity_px) {
    throw UsageError(
        fmt::format("the disparity range {} to {} px is empty: the least must not be above "
                    "the largest",
                    *min_disparity_px, *max_disparity_px));
  }
  if (min_disparity_px && static_cast<std::int64_t>(*max_disparity_px) - *min_disparity_px + 1 >
                              kLargestDisparityCount) {
    throw UsageError(
        fmt::format("the disparity range {} to {} px is too wide: at most {} disparities",
                    *min_disparity_px, *max_disparity_px, kLargestDisparityCount));
  }
  const int least_block = method == DisparityMethod::kBm ? 5 : 1;
  if (block_px != 0 && (block_px % 2 == 0 || block_px < least_block || block_px > 51)) {
    throw UsageError(
        fmt::format("block_px is {}: it must be odd, {} to 51, or 0 for the method's own", block_px,
                    least_block));
  }
  if (!(uniqueness_percent >= 0 && uniqueness_percent < 100)) {
    throw UsageError(
        fmt::format("uniqueness_percent is {}: it must be 0 to below 100", uniqueness_percent));
  }
  if (!(left_right_tolerance_px > 0)) {
    throw UsageError(
        fmt::format("left_right_tolerance_px is {}: it must be positive", left_right_tolerance_px));
  }
  if (refinement_radius_px < 2 || refinement_radius_px > 25) {
    throw UsageError(
        fmt::format("refinement_radius_px is {}: it must be 2 to 25", refinement_radius_px));
  }
}

DisparityMap ComputeDisparity(const GrayImage& left_rectified, const GrayImage& right_rectified,
                              const DisparityOptions& options,
                              const Image<std::uint8_t>* left_valid,
                              const Image<std::uint8_t>* right_valid) {
  options.Check();
  CheckPair(left_rectified, right_rectified, options, left_valid, right_valid);
  const cv::Mat1b left = internal::StretchTo8Bit(left_rectified, left_valid);
  const cv::Mat1b right = internal::StretchTo8Bit(right_rectified, right_valid);
  const DisparityRange range = ChooseRange(left, right, options, left_valid, right_valid);

  DisparityMap map;
  map.value_px = Image<float>(left_rectified.size(), kNaN);
  map.sigma_px = Image<float>(left_rectified.size(), kNaN);
  map.status = Image<Status>(left_rectified.size(), Status::kOk);
  map.min_disparity_px = range.minimum_px;
  map.max_disparity_px = range.minimum_px + range.count - 1;

  const cv::Mat1s from_left = internal::MatchDense(left, right, range, options);
  const cv::Mat1s from_right = internal::MatchDenseFromRight(left, right, range, options);
  const Image<float> start = CheckedStart(
      from_left, from_right, range, options.left_right_tolerance_px, left_valid, right_valid, &map);
  const RefinedDisparity refined = internal::RefineDisparity(left_rectified, right_rectified, start,
                                                             options.refinement_radius_px);
  const Image<float> sigma =
      internal::DisparitySigma(refined, left_rectified, options.refinement_radius_px);
  Deliver(refined, sigma, &map);
  DropSmallPatches(range, &map);
  return map;
}

}  // namespace plumbline
