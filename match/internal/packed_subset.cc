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
  SubsetOutline outline{radius, false, {}, {}};
  outline.begin.assign(static_cast<std::size_t>(2 * radius + 1), -radius);
  outline.end.assign(static_cast<std::size_t>(2 * radius + 1), radius + 1);
  return outline;
}

SubsetOutline SubsetOutline::Circle(int radius) {
  SubsetOutline outline{radius, true, {}, {}};
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

// Lists the rows of the subset and sets the weights. Returns how many pixels count.
int TakeRows(const ReferencePlanes& planes, const SubsetOutline& outline, int column, int row,
             PackedSubset& subset) {
  const ImageSize size = planes.grey->size();
  float* weight = subset.weight.data();
  subset.rows.clear();
  std::size_t at = 0;
  int total = 0;
  for (int i = 0; i <= 2 * outline.radius; ++i) {
    const int y = row + i - outline.radius;
    if (y < planes.edge || y >= size.height - planes.edge) continue;
    const int first = std::max(planes.edge, column + outline.begin[static_cast<std::size_t>(i)]);
    const int last =
        std::min(size.width - planes.edge, column + outline.end[static_cast<std::size_t>(i)]);
    const int count = last - first;
    if (count <= 0) continue;
    const int runs = (count + PackedSubset::kRun - 1) / PackedSubset::kRun;
    const auto padded = static_cast<std::size_t>(runs * PackedSubset::kRun);
    int counted = count;
    std::fill(weight + at, weight + at + padded, 0.0F);
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
    subset.rows.push_back({static_cast<float>(y - row), first - column, count, runs, at});
    at += padded;
    total += counted;
  }
  return total;
}

}  // namespace

int Pack(const ReferencePlanes& planes, const SubsetOutline& outline, int column, int row,
         float grey_offset, PackedSubset& subset) {
  const ImageSize size = planes.grey->size();
  const int radius = outline.radius;
  const int side = 2 * radius + 1;
  const int most = (side + PackedSubset::kRun - 1) / PackedSubset::kRun * PackedSubset::kRun;
  const std::size_t values = static_cast<std::size_t>(side) * static_cast<std::size_t>(most);
  const bool masked = planes.mask != nullptr;
  const int low = radius + planes.edge;
  const bool whole = !masked && column >= low && row >= low && column + low < size.width &&
                     row + low < size.height;
  int total = 0;
  if (whole && subset.whole_radius == radius && subset.whole_circle == outline.circle) {
    for (const PackedSubset::Row& r : subset.rows) total += r.count;
  } else {
    subset.weight.Resize(values);
    total = TakeRows(planes, outline, column, row, subset);
    subset.whole_radius = whole ? radius : -1;
    subset.whole_circle = outline.circle;
  }
  const auto copy = [&](const Image<float>* plane, float offset, AlignedFloats& to) {
    if (plane == nullptr) return;
    CopyPlane(subset, plane->row(row) + column, size.width, offset, masked, to.Resize(values));
  };
  copy(planes.grey, grey_offset, subset.grey);
  copy(planes.gradient_x, 0, subset.gradient_x);
  copy(planes.gradient_y, 0, subset.gradient_y);
  copy(planes.noise_x, 0, subset.noise_x);
  copy(planes.noise_y, 0, subset.noise_y);
  return total;
}

}  // namespace plumbline::internal
