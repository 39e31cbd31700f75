#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace plumbline {

// The middle value, the upper one of two. `values` must not be empty nor hold NaN.
template <typename T>
T Median(std::vector<T> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace plumbline
