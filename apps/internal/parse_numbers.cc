#include "apps/internal/parse_numbers.h"

#include <charconv>
#include <cmath>
#include <system_error>

namespace plumbline::internal {

std::optional<std::vector<double>> ParseNumbers(const std::string& text, char parted_by) {
  std::vector<double> numbers;
  const char* at = text.data();
  const char* const end = at + text.size();
  while (true) {
    double number = 0;
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc() || !std::isfinite(number)) return std::nullopt;
    numbers.push_back(number);
    if (next == end) return numbers;
    if (*next != parted_by) return std::nullopt;
    at = next + 1;
  }
}

}  // namespace plumbline::internal
