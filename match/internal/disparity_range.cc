#include "match/internal/disparity_range.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

namespace plumbline::internal {
namespace {

constexpr int kSearchWidth = 1000;  // wider images are averaged down by a whole factor
constexpr int kPatchRadius = 9;
constexpr int kGridColumns = 48;
constexpr int kGridRows = 32;
constexpr double kLeastCorrelation = 0.75;
constexpr double kLeastLead = 0.06;   // over the best place that is not a neighbour
constexpr double kLeastContrast = 4;  // standard deviation of a patch, of 255
constexpr std::size_t kFewestVotes = 12;

// Where the patch around (x, y) of `from` lies in the same row of `to`, if that is clear.
std::optional<int> FindAlongRow(const cv::Mat1b& from, const cv::Mat1b& to, int x, int y) {
  constexpr int r = kPatchRadius;
  const cv::Mat1b patch = from(cv::Rect(x - r, y - r, 2 * r + 1, 2 * r + 1));
  cv::Mat1f score;
  cv::matchTemplate(to.rowRange(y - r, y + r + 1), patch, score, cv::TM_CCOEFF_NORMED);
  double best = 0;
  cv::Point where;
  cv::minMaxLoc(score, nullptr, &best, nullptr, &where);
  if (!(best >= kLeastCorrelation)) return std::nullopt;
  for (int i = 0; i < score.cols; ++i) {
    if (std::abs(i - where.x) > 4 && static_cast<double>(score(0, i)) > best - kLeastLead) {
      return std::nullopt;
    }
  }
  return where.x + r;
}

bool Textured(const cv::Mat1b& image, int x, int y) {
  constexpr int r = kPatchRadius;
  cv::Scalar mean, deviation;
  cv::meanStdDev(image(cv::Rect(x - r, y - r, 2 * r + 1, 2 * r + 1)), mean, deviation);
  return deviation[0] >= kLeastContrast;
}

bool IsValid(const Image<std::uint8_t>* valid, int x, int y, int factor) {
  if (valid == nullptr) return true;
  return (*valid)(std::min(valid->height() - 1, y * factor + factor / 2),
                  std::min(valid->width() - 1, x * factor + factor / 2)) != 0;
}

struct Vote {
  int x, y, disparity;
};

// Votes that no other one nearby bears out are dropped: a lone wrong one would double the range.
std::vector<int> SupportedDisparities(const std::vector<Vote>& votes, int reach) {
  std::vector<int> kept;
  for (const Vote& a : votes) {
    int allies = 0;
    for (const Vote& b : votes) {
      const int distance = std::max(std::abs(a.x - b.x), std::abs(a.y - b.y));
      if (distance > 0 && distance <= reach && std::abs(a.disparity - b.disparity) <= 4) ++allies;
    }
    if (allies >= 2) kept.push_back(a.disparity);
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

}  // namespace

DisparityRange FindDisparityRange(const cv::Mat1b& left, const cv::Mat1b& right,
                                  const Image<std::uint8_t>* left_valid,
                                  const Image<std::uint8_t>* right_valid) {
  const int factor = std::max(1, (left.cols + kSearchWidth - 1) / kSearchWidth);
  cv::Mat1b small_left = left, small_right = right;
  if (factor > 1) {
    const cv::Size size(left.cols / factor, left.rows / factor);
    const cv::Rect whole(0, 0, size.width * factor, size.height * factor);
    cv::resize(left(whole), small_left, size, 0, 0, cv::INTER_AREA);
    cv::resize(right(whole), small_right, size, 0, 0, cv::INTER_AREA);
  }
  constexpr int r = kPatchRadius;
  const int width = small_left.cols - 2 * r, height = small_left.rows - 2 * r;
  if (width <= 0 || height <= 0) return {};
  const int columns = std::min(kGridColumns, width), rows = std::min(kGridRows, height);
  std::vector<std::optional<int>> found(static_cast<std::size_t>(columns * rows));
  std::vector<cv::Point> places(found.size());
  tbb::parallel_for(0, columns * rows, [&](int i) {
    const auto k = static_cast<std::size_t>(i);
    const int x = r + width * (2 * (i % columns) + 1) / (2 * columns);
    const int y = r + height * (2 * (i / columns) + 1) / (2 * rows);
    places[k] = {x, y};
    if (!IsValid(left_valid, x, y, factor) || !Textured(small_left, x, y)) return;
    const auto there = FindAlongRow(small_left, small_right, x, y);
    if (!there || !IsValid(right_valid, *there, y, factor)) return;
    const auto back = FindAlongRow(small_right, small_left, *there, y);
    if (back && std::abs(*back - x) <= 1) found[k] = x - *there;
  });
  std::vector<Vote> votes;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (found[i]) votes.push_back({places[i].x, places[i].y, *found[i]});
  }
  const int reach = 2 * std::max(width / columns, height / rows) + 2;
  const std::vector<int> kept = SupportedDisparities(votes, reach);
  if (kept.size() < kFewestVotes) return {};
  const int low = kept.front() * factor, high = kept.back() * factor;
  // Thin foreground and the far background fall between the patches: the margin is for them.
  const int margin = std::max(8, (high - low) / 6) + factor;
  return {low - margin, high - low + 2 * margin + 1};
}

}  // namespace plumbline::internal
