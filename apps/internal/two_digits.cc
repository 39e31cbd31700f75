#include "apps/internal/two_digits.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace plumbline::internal {
namespace {

constexpr double kLeast = 1e-6, kMost = 1e9;  // what is written without an exponent
constexpr int kMostDecimals = 7;

// Where the second significant digit of a rounded size stands: 10^this.
int PlaceOfSecondDigit(double size) {
  int exponent = static_cast<int>(std::floor(std::log10(size)));
  const double last = std::pow(10.0, exponent - 1);
  if (std::round(size / last) >= 100) ++exponent;  // 0.0996 is 0.10
  return exponent - 1;
}

}  // namespace

std::string TwoDigits(double size) {
  if (!(size >= kLeast && size < kMost)) return fmt::format("{:.2g}", size);
  const int place = PlaceOfSecondDigit(size);
  const double last = std::pow(10.0, place);
  return fmt::format("{:.{}f}", std::round(size / last) * last, std::max(0, -place));
}

std::string WithErrors(double value, double random, double calibration, int fewest) {
  if (!std::isfinite(value)) return "not known";
  int decimals = fewest;
  for (const double error : {random, calibration}) {
    if (!(std::isfinite(error) && error > 0)) continue;
    decimals = std::clamp(-PlaceOfSecondDigit(error), 0, kMostDecimals);
    break;
  }
  std::string text = fmt::format("{:.{}f}", value, decimals);
  // What rounds to zero has no sign.
  if (text.front() == '-' && text.find_first_of("123456789") == std::string::npos) text.erase(0, 1);
  for (const double error : {random, calibration}) {
    if (std::isfinite(error)) text += " +- " + TwoDigits(error);
  }
  return text;
}

}  // namespace plumbline::internal
