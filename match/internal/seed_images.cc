#include "match/internal/seed_images.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

Image<float> Halved(Image<float>& image) {
  Image<float> half({(image.width() + 1) / 2, (image.height() + 1) / 2});
  const cv::Mat1f from(image.height(), image.width(), image.data());
  cv::Mat1f to(half.height(), half.width(), half.data());
  cv::pyrDown(from, to, to.size());
  return half;
}

Image<std::uint8_t> Halved(const Image<std::uint8_t>& mask) {
  Image<std::uint8_t> half({(mask.width() + 1) / 2, (mask.height() + 1) / 2});
  for (int y = 0; y < half.height(); ++y) {
    for (int x = 0; x < half.width(); ++x) half(y, x) = mask(2 * y, 2 * x);
  }
  return half;
}

// Of the pixels of a rectangle that may be used, the one nearest their centroid.
std::optional<Eigen::Vector2i> MiddleOfMask(const Image<std::uint8_t>& mask, int x0, int x1, int y0,
                                            int y1) {
  std::int64_t count = 0, sum_x = 0, sum_y = 0;
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      if (mask(y, x) == 0) continue;
      ++count;
      sum_x += x;
      sum_y += y;
    }
  }
  if (count == 0) return std::nullopt;
  const Eigen::Vector2i middle(static_cast<int>(sum_x / count), static_cast<int>(sum_y / count));
  if (mask(middle.y(), middle.x()) != 0) return middle;
  Eigen::Vector2i best = middle;
  int nearest = std::numeric_limits<int>::max();
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      const int distance = (Eigen::Vector2i(x, y) - middle).squaredNorm();
      if (mask(y, x) == 0 || distance >= nearest) continue;
      nearest = distance;
      best = {x, y};
    }
  }
  return best;
}

}  // namespace

void CheckSeedInput(std::string_view what, const GrayImage& reference, const GrayImage& deformed,
                    const Image<std::uint8_t>* mask, int subset_px) {
  if (reference.size() != deformed.size()) {
    throw InputError(fmt::format(
        "{}: the reference image has {} x {} px and the deformed image {} x {} px; both "
        "must have the same size",
        what, reference.width(), reference.height(), deformed.width(), deformed.height()));
  }
  if (mask != nullptr && mask->size() != reference.size()) {
    throw InputError(
        fmt::format("{}: the mask has {} x {} px and the images {} x {} px; draw it on "
                    "the reference image",
                    what, mask->width(), mask->height(), reference.width(), reference.height()));
  }
  if (std::min(reference.width(), reference.height()) < subset_px) {
    throw InputError(
        fmt::format("{}: a subset of {} px does not fit into images of {} x {} px; take a smaller "
                    "subset or larger images",
                    what, subset_px, reference.width(), reference.height()));
  }
}

Image<float> ToFloat8(const GrayImage& image) {
  Image<float> out(image.size());
  const float scale = std::ldexp(1.0F, 8 - image.bits);
  std::transform(image.grey.values().begin(), image.grey.values().end(), out.values().begin(),
                 [scale](std::uint16_t grey) { return scale * static_cast<float>(grey); });
  return out;
}

std::vector<SeedLevel> BuildSeedLevels(const GrayImage& reference, const GrayImage& deformed,
                                       const Image<std::uint8_t>* mask, int longest_px,
                                       int shortest_px) {
  std::vector<SeedLevel> levels;
  levels.push_back({1, ToFloat8(reference), ToFloat8(deformed),
                    mask != nullptr ? *mask : Image<std::uint8_t>(reference.size(), 1)});
  for (std::uint8_t& valid : levels[0].mask.values()) valid = valid != 0 ? 1 : 0;
  while (true) {
    SeedLevel& last = levels.back();
    const int longer = std::max(last.mask.width(), last.mask.height());
    const int shorter = std::min(last.mask.width(), last.mask.height());
    if (longer <= longest_px || shorter < 2 * shortest_px) return levels;
    levels.push_back({2 * last.factor, Halved(last.reference), Halved(last.deformed),
                      Halved(std::as_const(last.mask))});
  }
}

std::vector<Eigen::Vector2i> SeedLattice(const Image<std::uint8_t>& mask, int spacing_px,
                                         int margin_px) {
  const int width = mask.width() - 2 * margin_px, height = mask.height() - 2 * margin_px;
  std::vector<Eigen::Vector2i> out;
  if (width <= 0 || height <= 0) return out;
  const int columns = std::max(1, (width + spacing_px / 2) / spacing_px);
  const int rows = std::max(1, (height + spacing_px / 2) / spacing_px);
  for (int i = 0; i < rows * columns; ++i) {
    const int row = i / columns, column = i % columns;
    const int x0 = margin_px + width * column / columns;
    const int x1 = margin_px + width * (column + 1) / columns;
    const int y0 = margin_px + height * row / rows, y1 = margin_px + height * (row + 1) / rows;
    if (const auto place = MiddleOfMask(mask, x0, x1, y0, y1)) out.push_back(*place);
  }
  return out;
}

}  // namespace plumbline::internal
