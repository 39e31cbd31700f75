#pragma once

#include <opencv2/core.hpp>

#include "calib/image.h"

namespace plumbline::internal {

// The image as CV_8UC1: 8-bit levels copied, more bits scaled down by 2^(bits - 8) with rounding.
cv::Mat ToMat8(const GrayImage& image);

// A CV_16UC1 view of the image's own memory, nothing copied: it must not outlive the image, nor be
// written to.
cv::Mat ToMat16(const GrayImage& image);

// A copy of a CV_8UC1 (bits = 8) or CV_16UC1 matrix (bits as given). Throws std::invalid_argument
// on any other type, or when `bits` is not in 8..16.
GrayImage FromMat(const cv::Mat& mat, int bits = 16);

}  // namespace plumbline::internal
