#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "calib/internal/detect_families.h"
#include "calib/internal/find_tags.h"
#include "calib/internal/opencv_image.h"
#include "calib/internal/saddle_fit.h"

namespace plumbline::internal {
namespace {

using Corners = std::array<Eigen::Vector2d, 4>;
struct FittedTag {
  std::array<std::optional<SaddleFit>, 4> corners;
  int Count() const {
    return static_cast<int>(
        std::count_if(corners.begin(), corners.end(), [](const auto& c) { return c.has_value(); }));
  }
};

// Both finders together: what one misses the other may see.
std::vector<Tag> FindGridTags(const cv::Mat& image, const std::string& family) {
  std::vector<Tag> tags;
  for (const int border_bits : {2, 1}) {
    tags = FindTags(image, family, border_bits);
    std::vector<int> known;
    for (const Tag& tag : tags) known.push_back(tag.id);
    for (const Tag& tag : FindTagsByContours(image, family, border_bits)) {
      if (std::find(known.begin(), known.end(), tag.id) == known.end()) tags.push_back(tag);
    }
    if (!tags.empty()) break;
  }
  return tags;
}

double SideOf(const Corners& corners) {
  double sum = 0;
  for (std::size_t k = 0; k < 4; ++k) sum += (corners[k] - corners[(k + 1) % 4]).norm();
  return sum / 4;
}

cv::Point2f ToCv(const Eigen::Vector2d& p) {
  return {static_cast<float>(p.x()), static_cast<float>(p.y())};
}

Eigen::Vector2d Nominal(const BoardSpec& spec, int tag, std::size_t corner) {
  return spec.NominalPoint(4 * tag + static_cast<int>(corner)).head<2>();
}

// Tags of the board that agree with its layout. A tag elsewhere in the room, or misread, does not.
std::map<int, Corners> Consistent(const BoardSpec& spec, const std::vector<Tag>& tags) {
  std::vector<cv::Point2f> board, image;
  std::vector<double> sides;
  for (const Tag& tag : tags) {
    sides.push_back(SideOf(tag.corners));
    for (std::size_t k = 0; k < 4; ++k) {
      board.push_back(ToCv(Nominal(spec, tag.id, k)));
      image.push_back(ToCv(tag.corners[k]));
    }
  }
  std::map<int, Corners> out;
  if (tags.empty()) return out;
  std::nth_element(sides.begin(), sides.begin() + static_cast<std::ptrdiff_t>(sides.size() / 2),
                   sides.end());
  const double tolerance = 0.4 * sides[sides.size() / 2];
  std::vector<std::uint8_t> inlier;
  if (cv::findHomography(board, image, cv::RANSAC, tolerance, inlier).empty()) return out;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const auto first = inlier.begin() + static_cast<std::ptrdiff_t>(4 * i);
    if (std::all_of(first, first + 4, [](std::uint8_t in) { return in != 0; })) {
      out[tags[i].id] = tags[i].corners;
    }
  }
  return out;
}

// Fits the four corners of a tag where black meets black: the tag and the small square in the gap.
FittedTag FitTag(const BoardSpec& spec, const GrayImage& image, const Corners& start) {
  FittedTag out;
  const double side = SideOf(start);
  // Clear of the data bits (0.2 of the side from each edge) and of the far side of the gap.
  const double radius = std::clamp(0.8 * std::min(0.28, spec.spacing_ratio) * side, 3.0, 20.0);
  for (std::size_t k = 0; k < 4; ++k) {
    const bool right = k == 1 || k == 2, top = k >= 2;
    const Eigen::Vector2d along = top ? start[2] - start[3] : start[1] - start[0];
    const Eigen::Vector2d down = right ? start[1] - start[2] : start[0] - start[3];
    const auto fit = FitSaddle(image, start[k], along, down, radius);
    // Tag and square fill the quadrants right-up and left-down of the bottom left and top right
    // corners, the other two quadrants of the other corners.
    const bool dark_between = k % 2 == 1;
    if (!fit || fit->dark_between != dark_between) continue;
    if ((fit->pixel - start[k]).norm() > 0.15 * side + 0.5) continue;
    out.corners[k] = fit;
  }
  return out;
}

// Corners of a tag that was not read, from those of tags that were fitted next to it.
std::optional<Corners> PredictTag(const BoardSpec& spec, const std::map<int, FittedTag>& fitted,
                                  int tag) {
  const int column = tag % spec.columns, row = tag / spec.columns;
  std::vector<cv::Point2f> board, image;
  int near = 0;
  for (const auto& [other, fit] : fitted) {
    const int dc = std::abs(other % spec.columns - column),
              dr = std::abs(other / spec.columns - row);
    if (dc > 2 || dr > 2) continue;
    near += dc + dr <= 2 && fit.Count() >= 2;
    for (std::size_t k = 0; k < 4; ++k) {
      if (!fit.corners[k]) continue;
      board.push_back(ToCv(Nominal(spec, other, k)));
      image.push_back(ToCv(fit.corners[k]->pixel));
    }
  }
  if (near < 1 || board.size() < 6) return std::nullopt;
  const cv::Mat H = cv::findHomography(board, image);
  if (H.empty()) return std::nullopt;
  std::vector<cv::Point2f> corners, mapped;
  for (std::size_t k = 0; k < 4; ++k) corners.push_back(ToCv(Nominal(spec, tag, k)));
  cv::perspectiveTransform(corners, mapped, H);
  Corners out;
  for (std::size_t k = 0; k < 4; ++k) out[k] = {mapped[k].x, mapped[k].y};
  return out;
}

double MedianContrast(const std::map<int, FittedTag>& fitted) {
  std::vector<double> all;
  for (const auto& [tag, fit] : fitted) {
    for (const auto& corner : fit.corners) {
      if (corner) all.push_back(corner->contrast);
    }
  }
  if (all.empty()) return 0;
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return *middle;
}

// Tags that could not be read but are there: all four corners at the places that their neighbours
// predict, with the right colours and a contrast like the others'.
void AddUnread(const BoardSpec& spec, const GrayImage& image, std::map<int, FittedTag>& fitted) {
  const double least_contrast = 0.5 * MedianContrast(fitted);
  for (bool more = true; more;) {
    more = false;
    for (int tag = 0; tag < spec.columns * spec.rows; ++tag) {
      if (fitted.count(tag) != 0) continue;
      const auto predicted = PredictTag(spec, fitted, tag);
      if (!predicted) continue;
      const FittedTag fit = FitTag(spec, image, *predicted);
      const bool strong = std::all_of(fit.corners.begin(), fit.corners.end(), [&](const auto& c) {
        return c && c->contrast > least_contrast;
      });
      if (!strong) continue;
      fitted[tag] = fit;
      more = true;
    }
  }
}

}  // namespace

BoardDetection DetectAprilGrid(const BoardSpec& spec, const GrayImage& image) {
  const cv::Mat grey = ToMat8(image);
  std::vector<Tag> tags, foreign;
  for (const Tag& tag : FindGridTags(grey, spec.dictionary)) {
    (tag.id < spec.columns * spec.rows ? tags : foreign).push_back(tag);
  }
  if (tags.empty()) {
    return NotFound(
        foreign.empty()
            ? fmt::format("no {} tag found; is the board in view, sharp and large enough?",
                          spec.dictionary)
            : fmt::format("{} tags found, but none with an id below {}; check the board word",
                          foreign.size(), spec.columns * spec.rows));
  }
  std::sort(tags.begin(), tags.end(), [](const Tag& a, const Tag& b) { return a.id < b.id; });
  for (std::size_t i = 1; i < tags.size(); ++i) {
    if (tags[i].id == tags[i - 1].id) {
      return NotFound(
          fmt::format("tag {} is in the photograph twice; show one board at a time", tags[i].id));
    }
  }
  const auto consistent = Consistent(spec, tags);
  if (2 * consistent.size() < tags.size()) {
    return NotFound(fmt::format(
        "{} tags found, but only {} of them lie as on {}; check columns, rows and spacing",
        tags.size(), consistent.size(), spec.Word()));
  }
  std::map<int, FittedTag> fitted;
  for (const auto& [tag, corners] : consistent) {
    const FittedTag fit = FitTag(spec, image, corners);
    if (fit.Count() > 0) fitted[tag] = fit;
  }
  AddUnread(spec, image, fitted);
  BoardDetection out;
  for (const auto& [tag, fit] : fitted) {
    for (std::size_t k = 0; k < 4; ++k) {
      if (!fit.corners[k]) continue;
      out.ids.push_back(4 * tag + static_cast<int>(k));
      out.pixels.push_back(fit.corners[k]->pixel);
      out.sigma_px.push_back(std::sqrt(fit.corners[k]->cov_px2.trace() / 2));
    }
  }
  if (out.ids.size() < 4) {
    return NotFound(
        fmt::format("{} tags read, but only {} corners could be fitted; too blurred or "
                    "too small, or without black squares between the tags?",
                    tags.size(), out.ids.size()));
  }
  return out;
}

}  // namespace plumbline::internal
