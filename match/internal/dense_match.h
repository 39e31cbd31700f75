#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

#include "match/disparity.h"

namespace plumbline::internal {

// The disparities searched: minimum_px, minimum_px + 1, ..., minimum_px + count - 1.
struct DisparityRange {
  int minimum_px = 0;
  int count = 0;
};

// The image in 8 bits, as OpenCV's matchers want it: the grey levels below which 0.5 % and 99.5 %
// of the valid pixels lie become 0 and 255, what is beyond is clipped. Each image by its own
// percentiles, so that a difference in exposure goes. A blank image becomes all 0.
cv::Mat1b StretchTo8Bit(const GrayImage& image, const Image<std::uint8_t>* valid);

// Disparities of every pixel of `left`, in 1/16 px above range.minimum_px; negative where the
// best match is not unique. Columns whose match would lie outside `right` are searched too, against
// the repeated border; the caller drops them. Nothing in it depends on the number of threads.
cv::Mat1s MatchDense(const cv::Mat1b& left, const cv::Mat1b& right, const DisparityRange& range,
                     const DisparityOptions& options);

// The same for the pixels of `right`: (x, y) there is (x + value, y) on the left.
cv::Mat1s MatchDenseFromRight(const cv::Mat1b& left, const cv::Mat1b& right,
                              const DisparityRange& range, const DisparityOptions& options);

// Bytes that the matcher itself needs at most for such a pair, all concurrent bands counted.
std::int64_t DenseMatchBytes(ImageSize size, int disparity_count, DisparityMethod method);

// Block size in use: the one given, or the method's own.
int BlockPx(const DisparityOptions& options);

}  // namespace plumbline::internal
