#include "calib/internal/opencv_image.h"

#include <stdexcept>

namespace plumbline::internal {

cv::Mat ToMat8(const GrayImage& image) {
  cv::Mat out;
  ToMat16(image).convertTo(out, CV_8U, 1.0 / (1 << (image.bits - 8)));
  return out;
}

cv::Mat ToMat16(const GrayImage& image) {
  // cv::Mat has no const view; callers are told not to write.
  return cv::Mat(image.height(), image.width(), CV_16UC1,
                 const_cast<std::uint16_t*>(image.grey.data()));
}

GrayImage FromMat(const cv::Mat& mat, int bits) {
  if (mat.type() != CV_8UC1 && mat.type() != CV_16UC1) {
    throw std::invalid_argument("FromMat: only 8-bit and 16-bit single-channel images");
  }
  if (mat.depth() == CV_8U) bits = 8;
  if (bits < 8 || bits > 16) throw std::invalid_argument("FromMat: bits must be 8 to 16");
  GrayImage image{Image<std::uint16_t>({mat.cols, mat.rows}), bits};
  cv::Mat target(mat.rows, mat.cols, CV_16UC1, image.grey.data());
  mat.convertTo(target, CV_16U);
  return image;
}

}  // namespace plumbline::internal
