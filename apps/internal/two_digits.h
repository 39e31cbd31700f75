#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>

namespace plumbline::internal {

// The size of an error as people write it: two significant digits, without an exponent where that
// can be read ("0.000031", "0.10", "85", "920").
inline std::string TwoDigits(double size) {
  if (!(size >= 1e-6 && size < 1e9)) return fmt::format("{:.2g}", size);
  int exponent = static_cast<int>(std::floor(std::log10(size)));
  double last = std::pow(10.0, exponent - 1);
  const double rounded = std::round(size / last) * last;
  if (rounded >= 100 * last * (1 - 1e-9)) ++exponent;  // 0.0996 is 0.10
  return fmt::format("{:.{}f}", rounded, std::max(0, 1 - exponent));
}

}  // namespace plumbline::internal
