#include <algorithm>
#include <cmath>
#include <cstdint>

#include "match/internal/subset_sums.h"

namespace plumbline::internal {

float* AlignedFloats::Resize(std::size_t size) {
  constexpr std::size_t kAlignment = 64;
  if (storage_.size() < size + kAlignment / sizeof(float)) {
    storage_.resize(size + kAlignment / sizeof(float));
  }
  const auto address = reinterpret_cast<std::uintptr_t>(storage_.data());
  const std::size_t skip = (kAlignment - address % kAlignment) % kAlignment;
  data_ = storage_.data() + skip / sizeof(float);
  return data_;
}

SubsetOutline SubsetOutline::Square(int radius) {
  SubsetOutline outline{radius, {}, {}};
  outline.begin.assign(static_cast<std::size_t>(2 * radius + 1), -radius);
  outline.end.assign(static_cast<std::size_t>(2 * radius + 1), radius + 1);
  return outline;
}

SubsetOutline SubsetOutline::Circle(int radius) {
  SubsetOutline outline{radius, {}, {}};
  // The disc of diameter 2 radius + 1, by the pixels' centres.
  const double r = radius + 0.5;
  for (int y = -radius; y <= radius; ++y) {
    const int half = static_cast<int>(std::floor(std::sqrt(r * r - y * y)));
    outline.begin.push_back(-half);
    outline.end.push_back(half + 1);
  }
  return outline;
}

namespace {

// The planes' values in a row, those between that do not count set to zero.
void CopyRow(const Image<float>* plane, int row, int column, int count, int padded, float offset,
             const float* weight, float* to) {
  if (plane == nullptr) return;
  const float* from = plane->row(row) + column;
  for (int i = 0; i < count; ++i) to[i] = weight[i] * (from[i] - offset);
  std::fill(to + count, to + padded, 0.0F);
}

}  // namespace

int Pack(const ReferencePlanes& planes, const SubsetOutline& outline, int column, int row,
         float grey_offset, PackedSubset& subset) {
  const ImageSize size = planes.grey->size();
  const int side = 2 * outline.radius + 1;
  const int most = (side + PackedSubset::kRun - 1) / PackedSubset::kRun * PackedSubset::kRun;
  const std::size_t values = static_cast<std::size_t>(side) * static_cast<std::size_t>(most);
  float* weight = subset.weight.Resize(values);
  float* grey = subset.grey.Resize(values);
  float* gradient_x = subset.gradient_x.Resize(values);
  float* gradient_y = subset.gradient_y.Resize(values);
  float* noise_x = planes.noise_x != nullptr ? subset.noise_x.Resize(values) : nullptr;
  float* noise_y = planes.noise_y != nullptr ? subset.noise_y.Resize(values) : nullptr;
  subset.rows.clear();
  std::size_t at = 0;
  int total = 0;
  for (int i = 0; i < side; ++i) {
    const int y = row + i - outline.radius;
    if (y < 0 || y >= size.height) continue;
    const int first = std::max(0, column + outline.begin[static_cast<std::size_t>(i)]);
    const int last = std::min(size.width, column + outline.end[static_cast<std::size_t>(i)]);
    const int count = last - first;
    if (count <= 0) continue;
    const int runs = (count + PackedSubset::kRun - 1) / PackedSubset::kRun;
    const int padded = runs * PackedSubset::kRun;
    int counted = count;
    if (planes.mask != nullptr) {
      const unsigned char* mask = planes.mask->row(y) + first;
      counted = 0;
      for (int k = 0; k < count; ++k) {
        weight[at + static_cast<std::size_t>(k)] = mask[k] != 0 ? 1.0F : 0.0F;
        counted += mask[k] != 0 ? 1 : 0;
      }
      if (counted == 0) continue;
    } else {
      std::fill(weight + at, weight + at + count, 1.0F);
    }
    std::fill(weight + at + count, weight + at + padded, 0.0F);
    CopyRow(planes.grey, y, first, count, padded, grey_offset, weight + at, grey + at);
    CopyRow(planes.gradient_x, y, first, count, padded, 0, weight + at, gradient_x + at);
    CopyRow(planes.gradient_y, y, first, count, padded, 0, weight + at, gradient_y + at);
    CopyRow(planes.noise_x, y, first, count, padded, 0, weight + at, noise_x + at);
    CopyRow(planes.noise_y, y, first, count, padded, 0, weight + at, noise_y + at);
    subset.rows.push_back({static_cast<float>(y - row), first - column, runs, at});
    at += static_cast<std::size_t>(padded);
    total += counted;
  }
  return total;
}

}  // namespace plumbline::internal
