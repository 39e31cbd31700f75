#include "io/internal/frame_selection.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <optional>

#include "calib/error.h"
#include "io/internal/parse_text.h"

namespace plumbline::internal {
namespace {

double SecondsPerUnit(const std::string& heading) {
  const std::array<std::pair<std::string_view, double>, 3> units = {
      {{"ns", 1e-9}, {"us", 1e-6}, {"ms", 1e-3}}};
  for (const auto& unit : units) {
    if (heading.find(unit.first) != std::string::npos) return unit.second;
  }
  return 1;
}

}  // namespace

FrameSelection ParseFrames(const std::string& text, std::int64_t count) {
  FrameSelection selection;
  selection.end = count;
  if (text.empty()) return selection;
  const auto refuse = [&] [[noreturn]] () {
    throw UsageError(fmt::format(
        "the frames \"{}\" are no slice: write first:end:step as in 10:200:2, a part may be left "
        "out, the step must be positive",
        text));
  };
  std::vector<std::optional<std::int64_t>> parts;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t colon = std::min(text.find(':', at), text.size());
    const std::string_view part = Trimmed(std::string_view(text).substr(at, colon - at));
    parts.push_back(ParseNumber<std::int64_t>(part));
    if (!part.empty() && !parts.back()) refuse();
    at = colon + 1;
  }
  if (parts.size() > 3 || (parts.size() == 1 && !parts[0])) refuse();
  const auto from_end = [&](std::int64_t i) {
    return std::clamp<std::int64_t>(i < 0 ? i + count : i, 0, count);
  };
  if (parts[0]) selection.first = from_end(*parts[0]);
  if (parts.size() == 1) selection.end = std::min(count, selection.first + 1);
  if (parts.size() > 1 && parts[1]) selection.end = from_end(*parts[1]);
  if (parts.size() > 2 && parts[2]) selection.step = *parts[2];
  if (selection.step <= 0) refuse();
  return selection;
}

std::vector<double> ReadTimestamps(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) throw InputError(fmt::format("the table of times {} cannot be read", file.string()));
  // Nanoseconds since 1970 do not fit a double: the first row is subtracted as an integer.
  std::vector<double> seconds;
  std::optional<std::int64_t> first_integer;
  std::optional<double> first_number;
  double unit = 0;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (Trimmed(line).empty()) continue;
    const std::size_t comma = line.find_last_of(",;\t");
    const std::string_view cell =
        Trimmed(std::string_view(line).substr(comma == std::string::npos ? 0 : comma + 1));
    const auto value = ParseNumber<double>(cell);
    if (!value) {
      if (seconds.empty() && unit == 0) {
        unit = SecondsPerUnit(std::string(cell));
        continue;
      }
      throw InputError(fmt::format("{}, line {}: \"{}\" is no time", file.string(), number, cell));
    }
    if (unit == 0) unit = *value > 1e12 ? 1e-9 : 1;
    const auto integer = ParseNumber<std::int64_t>(cell);
    if (seconds.empty()) {
      first_integer = integer;
      first_number = value;
    }
    const double since_first = integer && first_integer
                                   ? static_cast<double>(*integer - *first_integer)
                                   : *value - *first_number;
    seconds.push_back(since_first * unit);
  }
  if (seconds.empty()) throw InputError(fmt::format("{} holds no times", file.string()));
  return seconds;
}

}  // namespace plumbline::internal
