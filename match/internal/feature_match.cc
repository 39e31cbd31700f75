#include "match/internal/feature_match.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <flann/flann.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "match/internal/dense_match.h"

namespace plumbline::internal {
namespace {

constexpr std::size_t kNone = static_cast<std::size_t>(-1);

bool StrongerFirst(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  return std::tuple(-a.response, a.pt.y, a.pt.x, a.size, a.angle) <
         std::tuple(-b.response, b.pt.y, b.pt.x, b.size, b.angle);
}

bool UpperFirst(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  return std::tuple(a.pt.y, a.pt.x, a.size, a.angle) < std::tuple(b.pt.y, b.pt.x, b.size, b.angle);
}

// The strongest of each cell; cells that have fewer than their share leave it to the others.
std::vector<cv::KeyPoint> SpreadEvenly(std::vector<cv::KeyPoint> points, cv::Size size,
                                       int max_features) {
  constexpr int kPerCell = 12;
  const double cell_px =
      std::max(1.0, std::sqrt(static_cast<double>(size.area()) * kPerCell / max_features));
  const int columns = static_cast<int>(size.width / cell_px) + 1;
  const int rows = static_cast<int>(size.height / cell_px) + 1;
  std::sort(points.begin(), points.end(), StrongerFirst);
  std::vector<int> taken(static_cast<std::size_t>(rows * columns), 0);
  std::vector<std::pair<int, std::size_t>> order;  // rank within its cell, then strength
  for (std::size_t i = 0; i < points.size(); ++i) {
    const int row =
        std::clamp(static_cast<int>(static_cast<double>(points[i].pt.y) / cell_px), 0, rows - 1);
    const int column =
        std::clamp(static_cast<int>(static_cast<double>(points[i].pt.x) / cell_px), 0, columns - 1);
    order.emplace_back(taken[static_cast<std::size_t>(row * columns + column)]++, i);
  }
  std::sort(order.begin(), order.end());
  order.resize(std::min(order.size(), static_cast<std::size_t>(max_features)));
  std::vector<cv::KeyPoint> kept;
  for (const auto& [rank, i] : order) kept.push_back(points[i]);
  std::sort(kept.begin(), kept.end(), UpperFirst);
  return kept;
}

flann::Matrix<float> AsFlann(const cv::Mat1f& descriptors) {
  return {const_cast<float*>(descriptors.ptr<float>()), static_cast<std::size_t>(descriptors.rows),
          static_cast<std::size_t>(descriptors.cols)};
}

// For each row of `from` the row of `to` that is nearest and clearly so, or kNone.
std::vector<std::size_t> NearestOf(const cv::Mat1f& from, const cv::Mat1f& to, double max_ratio) {
  flann::KDTreeSingleIndex<flann::L2<float>> index(AsFlann(to), flann::KDTreeSingleIndexParams(20));
  index.buildIndex();
  std::vector<std::size_t> nearest(static_cast<std::size_t>(from.rows), kNone);
  tbb::parallel_for(tbb::blocked_range<int>(0, from.rows, 64), [&](const auto& range) {
    const cv::Mat1f block = from.rowRange(range.begin(), range.end());
    std::vector<std::vector<std::size_t>> indices;
    std::vector<std::vector<float>> squared;
    index.knnSearch(AsFlann(block), indices, squared, 2,
                    flann::SearchParams(flann::FLANN_CHECKS_UNLIMITED));
    for (std::size_t i = 0; i < indices.size(); ++i) {
      if (indices[i].size() < 2) continue;
      const double ratio2 = max_ratio * max_ratio;
      if (static_cast<double>(squared[i][0]) > ratio2 * static_cast<double>(squared[i][1]))
        continue;
      nearest[static_cast<std::size_t>(range.begin()) + i] = indices[i][0];
    }
  });
  return nearest;
}

}  // namespace

Features FindFeatures(const GrayImage& image, const Image<std::uint8_t>* valid, int max_features,
                      int longest_px) {
  cv::Mat1b grey = StretchTo8Bit(image, valid);
  const int factor =
      (std::max(image.width(), image.height()) + longest_px - 1) / std::max(1, longest_px);
  if (factor > 1) {
    const cv::Size size(std::max(1, image.width() / factor), std::max(1, image.height() / factor));
    cv::Mat1b small;
    cv::resize(grey(cv::Rect(0, 0, size.width * factor, size.height * factor)), small, size, 0, 0,
               cv::INTER_AREA);
    grey = small;
  }
  cv::Mat1b allowed(grey.size(), 255);
  for (int y = 0; valid != nullptr && y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      const int row = y * factor + factor / 2, column = x * factor + factor / 2;
      allowed(y, x) = (*valid)(row, column) != 0 ? 255 : 0;
    }
  }
  const auto sift = cv::SIFT::create();
  std::vector<cv::KeyPoint> points;
  sift->detect(grey, points, allowed);
  points = SpreadEvenly(std::move(points), grey.size(), max_features);
  Features out;
  out.factor = factor;
  if (points.empty()) return out;
  cv::Mat descriptors;
  sift->compute(grey, points, descriptors);
  out.descriptors = descriptors;
  for (const cv::KeyPoint& point : points) {
    out.places_px.push_back(
        Eigen::Vector2d(static_cast<double>(point.pt.x), static_cast<double>(point.pt.y)) * factor +
        Eigen::Vector2d::Constant((factor - 1) / 2.0));
  }
  return out;
}

std::vector<FeatureMatch> MatchFeatures(const Features& from, const Features& to,
                                        double max_ratio) {
  std::vector<FeatureMatch> out;
  if (from.places_px.size() < 2 || to.places_px.size() < 2) return out;
  const auto forward = NearestOf(from.descriptors, to.descriptors, max_ratio);
  const auto backward = NearestOf(to.descriptors, from.descriptors, max_ratio);
  for (std::size_t i = 0; i < forward.size(); ++i) {
    if (forward[i] != kNone && backward[forward[i]] == i) out.push_back({i, forward[i]});
  }
  return out;
}

}  // namespace plumbline::internal
