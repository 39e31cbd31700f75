#pragma once

#include <cmath>
#include <filesystem>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>

#include "calib/image.h"
#include "match/disparity.h"

namespace plumbline::testing {

// A pair of known disparity. Truth is NaN where unknown.
struct KnownPair {
  GrayImage left, right;
  cv::Mat1b left8, right8;
  Image<float> truth;
  double truth_variance_px2 = 0;  // of its quantisation
  Image<std::uint8_t> visible;    // 0 where hidden from the right camera; empty where not known
};

inline GrayImage ReadGray(const std::filesystem::path& file, cv::Mat1b* as_mat) {
  const cv::Mat1b mat = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  if (mat.empty()) throw std::runtime_error("cannot read " + file.string());
  GrayImage image{Image<std::uint16_t>({mat.cols, mat.rows}), 8};
  for (int y = 0; y < mat.rows; ++y) {
    for (int x = 0; x < mat.cols; ++x) image.grey(y, x) = mat(y, x);
  }
  *as_mat = mat;
  return image;
}

inline Image<float> ReadTruth(const std::filesystem::path& file, double scale) {
  const cv::Mat raw = cv::imread(file.string(), cv::IMREAD_UNCHANGED);
  if (raw.empty()) throw std::runtime_error("cannot read " + file.string());
  cv::Mat1f mat;
  raw.convertTo(mat, CV_32F, scale);
  Image<float> truth({mat.cols, mat.rows}, std::numeric_limits<float>::quiet_NaN());
  for (int y = 0; y < mat.rows; ++y) {
    for (int x = 0; x < mat.cols; ++x) {
      if (std::isfinite(mat(y, x)) && mat(y, x) > 0) truth(y, x) = mat(y, x);
    }
  }
  return truth;
}

// cones or teddy of Middlebury 2003; hidden pixels by both truths' disagreement.
inline KnownPair ReadMiddlebury2003(const std::filesystem::path& folder) {
  KnownPair pair;
  pair.left = ReadGray(folder / "im2.png", &pair.left8);
  pair.right = ReadGray(folder / "im6.png", &pair.right8);
  pair.truth = ReadTruth(folder / "disp2.png", 0.25);
  pair.truth_variance_px2 = 0.25 * 0.25 / 12;
  const Image<float> from_right = ReadTruth(folder / "disp6.png", 0.25);
  pair.visible = Image<std::uint8_t>(pair.truth.size(), 0);
  for (int y = 0; y < pair.truth.height(); ++y) {
    for (int x = 0; x < pair.truth.width(); ++x) {
      const float d = pair.truth(y, x);
      if (!std::isfinite(d)) continue;
      const int there = static_cast<int>(std::lround(static_cast<float>(x) - d));
      pair.visible(y, x) = there >= 0 && std::abs(from_right(y, there) - d) <= 1;
    }
  }
  return pair;
}

inline KnownPair ReadMotorcycle(const std::filesystem::path& folder) {
  KnownPair pair;
  pair.left = ReadGray(folder / "left.png", &pair.left8);
  pair.right = ReadGray(folder / "right.png", &pair.right8);
  pair.truth = ReadTruth(folder / "disp_left.pfm", 1);
  return pair;
}

// Shares of the pixels of known truth. An inlier is off by less than 2 px.
struct DisparityScore {
  double density = 0;         // delivered, of the known
  double bad1 = 0, bad2 = 0;  // off by more than 1 and 2 px, of the delivered
  double wrong1 = 0;          // off by more than 1 px or not delivered, of the known
  double inlier_rms_px = 0;
  double within_one_sigma = 0;  // of the inliers, the truth's own variance added
  double mean_squared_z = 0;    // of the inliers
};

inline DisparityScore Score(const Image<float>& value, const Image<float>* sigma,
                            const Image<float>& truth, double truth_variance_px2,
                            const Image<std::uint8_t>* counted) {
  double known = 0, delivered = 0, bad1 = 0, bad2 = 0, inliers = 0, squares = 0, within = 0, z2 = 0;
  for (std::size_t i = 0; i < truth.pixel_count(); ++i) {
    if (!std::isfinite(truth.data()[i])) continue;
    if (counted != nullptr && counted->data()[i] == 0) continue;
    ++known;
    if (!std::isfinite(value.data()[i])) continue;
    ++delivered;
    const double e =
        std::abs(static_cast<double>(value.data()[i]) - static_cast<double>(truth.data()[i]));
    bad1 += e > 1;
    bad2 += e > 2;
    if (e >= 2) continue;
    ++inliers;
    squares += e * e;
    if (sigma == nullptr) continue;
    const double z =
        e * e / (std::pow(static_cast<double>(sigma->data()[i]), 2) + truth_variance_px2);
    within += z < 1;
    z2 += z;
  }
  return {delivered / known,
          bad1 / delivered,
          bad2 / delivered,
          1 - (delivered - bad1) / known,
          std::sqrt(squares / inliers),
          within / inliers,
          z2 / inliers};
}

inline Image<float> FromOpenCv(const cv::Mat& found, int minimum_px) {
  Image<float> value({found.cols, found.rows}, std::numeric_limits<float>::quiet_NaN());
  for (int y = 0; y < found.rows; ++y) {
    for (int x = 0; x < found.cols; ++x) {
      const float d = static_cast<float>(found.at<short>(y, x)) / 16;
      if (d >= static_cast<float>(minimum_px)) value(y, x) = d;
    }
  }
  return value;
}

}  // namespace plumbline::testing
