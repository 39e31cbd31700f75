#include "io/channel_table.h"

#include <csv.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <set>
#include <string>

#include "calib/error.h"
#include "io/internal/parse_text.h"

namespace plumbline {
namespace {

using internal::ParseNumber;
using internal::Trimmed;
using Cells = std::vector<std::string>;

// Units that the last part of a heading such as force_x_N may be.
constexpr std::array<std::string_view, 42> kUnits = {
    "s",    "ms",    "us",   "ns",   "N",     "kN", "Nm",    "N.m",   "N m",  "kNm", "m/s",
    "mm/s", "km/h",  "mph",  "m/s2", "m/s^2", "g",  "rad/s", "deg/s", "rad",  "deg", "rpm",
    "1/s",  "1/min", "Hz",   "mm",   "cm",    "m",  "km",    "bar",   "mbar", "Pa",  "kPa",
    "MPa",  "K",     "degC", "C",    "V",     "mV", "A",     "%",     "kg"};

struct Heading {
  std::string name, units;
};

Cells CellsOf(const std::string& line, char separator) {
  csv_parser parser;
  if (csv_init(&parser, CSV_APPEND_NULL) != 0) throw std::bad_alloc();
  const std::unique_ptr<csv_parser, decltype(&csv_free)> guard(&parser, &csv_free);
  csv_set_delim(&parser, static_cast<unsigned char>(separator));
  Cells cells;
  const auto cell = [](void* text, std::size_t size, void* to) {
    static_cast<Cells*>(to)->emplace_back(
        Trimmed(std::string_view(static_cast<const char*>(text), size)));
  };
  const auto row = [](int, void*) {};
  if (csv_parse(&parser, line.data(), line.size(), cell, row, &cells) != line.size()) {
    throw std::bad_alloc();
  }
  csv_fini(&parser, cell, row, &cells);
  return cells;
}

char SeparatorOf(const std::string& line) {
  char best = ',';
  for (const char candidate : {';', '\t'}) {
    if (std::count(line.begin(), line.end(), candidate) >
        std::count(line.begin(), line.end(), best)) {
      best = candidate;
    }
  }
  return best;
}

Heading HeadingOf(const std::string& text) {
  for (const auto& [open, close] : {std::pair('[', ']'), std::pair('(', ')')}) {
    const std::size_t at = text.find(open);
    if (at == std::string::npos || at == 0 || text.back() != close) continue;
    return {std::string(Trimmed(text.substr(0, at))),
            std::string(Trimmed(text.substr(at + 1, text.size() - at - 2)))};
  }
  const std::size_t at = text.rfind('_');
  if (at != std::string::npos && at > 0) {
    const std::string_view last = std::string_view(text).substr(at + 1);
    if (std::find(kUnits.begin(), kUnits.end(), last) != kUnits.end()) {
      return {text.substr(0, at), std::string(last)};
    }
  }
  return {text, ""};
}

std::optional<double> NumberOf(std::string text, char separator) {
  if (text.empty() || text == "-" || text == "nan" || text == "NaN" || text == "NAN") {
    return std::numeric_limits<double>::quiet_NaN();
  }
  if (separator != ',') std::replace(text.begin(), text.end(), ',', '.');
  const std::size_t sign = text.front() == '+' ? 1 : 0;
  return ParseNumber<double>(std::string_view(text).substr(sign));
}

bool IsTime(const Heading& heading) {
  std::string name = heading.name;
  for (char& c : name) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return name == "time" || name == "t" || name == "timestamp";
}

double SecondsPer(const std::string& units) {
  if (units == "ms") return 1e-3;
  if (units == "us") return 1e-6;
  if (units == "ns") return 1e-9;
  return 1;
}

class Table {
 public:
  explicit Table(const std::filesystem::path& file) : file_(file), in_(file) {
    if (!in_)
      throw InputError(fmt::format("the table of channels {} cannot be read", file.string()));
    ReadHeadings();
    Cells cells;
    bool first = true;
    while (NextLine(&cells)) {
      if (first && IsOfUnits(cells)) {
        for (std::size_t c = 0; c < cells.size(); ++c) headings_[c].units = cells[c];
      } else {
        AddRow(cells);
      }
      first = false;
    }
    if (time_s_.empty()) throw InputError(fmt::format("{} holds no rows", file.string()));
  }

  std::vector<Channel> Channels() && {
    std::vector<Channel> channels;
    const double per_unit = SecondsPer(headings_[time_column_].units);
    for (double& time : time_s_) time *= per_unit;
    for (std::size_t c = 0; c < headings_.size(); ++c) {
      if (c == time_column_) continue;
      channels.push_back({headings_[c].name, headings_[c].units,
                          fmt::format("{} of {}", headings_[c].name, file_.filename().string()),
                          time_s_, std::move(values_[c])});
    }
    return channels;
  }

 private:
  bool NextLine(Cells* cells) {
    for (std::string line; std::getline(in_, line);) {
      ++number_;
      const std::string_view text = Trimmed(line);
      if (text.empty() || text.front() == '#') continue;
      if (headings_.empty()) separator_ = SeparatorOf(line);
      *cells = CellsOf(line, separator_);
      return true;
    }
    return false;
  }

  void ReadHeadings() {
    Cells cells;
    if (!NextLine(&cells)) throw InputError(fmt::format("{} is empty", file_.string()));
    if (cells.size() < 2) {
      throw InputError(fmt::format(
          "{}, line {}: one column alone is no channel; a time and one or more signals are wanted, "
          "parted by commas, semicolons or tabs",
          file_.string(), number_));
    }
    std::set<std::string> names;
    for (std::size_t c = 0; c < cells.size(); ++c) {
      if (NumberOf(cells[c], separator_)) {
        throw InputError(fmt::format(
            "{}, line {}: \"{}\" is no name of a column; the first line names the columns, as "
            "\"time [s],wheel_speed [rad/s]\"",
            file_.string(), number_, cells[c]));
      }
      headings_.push_back(HeadingOf(cells[c]));
      if (!names.insert(headings_.back().name).second) {
        throw InputError(fmt::format("{}, line {}: two columns are named \"{}\"", file_.string(),
                                     number_, headings_.back().name));
      }
    }
    const auto time = std::find_if(headings_.begin(), headings_.end(), IsTime);
    time_column_ = time == headings_.end() ? 0 : static_cast<std::size_t>(time - headings_.begin());
    values_.resize(headings_.size());
  }

  bool IsOfUnits(const Cells& cells) const {
    return cells.size() == headings_.size() &&
           std::all_of(cells.begin(), cells.end(), [&](const std::string& cell) {
             return !cell.empty() && (cell == "-" || !NumberOf(cell, separator_));
           });
  }

  void AddRow(const Cells& cells) {
    if (cells.size() != headings_.size()) {
      throw InputError(fmt::format("{}, line {}: {} cells, and the first line names {} columns",
                                   file_.string(), number_, cells.size(), headings_.size()));
    }
    for (std::size_t c = 0; c < cells.size(); ++c) {
      const std::optional<double> value = NumberOf(cells[c], separator_);
      if (!value) {
        throw InputError(fmt::format("{}, line {}, column {}: \"{}\" is no number", file_.string(),
                                     number_, headings_[c].name, cells[c]));
      }
      if (c == time_column_) {
        if (!std::isfinite(*value) || (!time_s_.empty() && *value < time_s_.back())) {
          throw InputError(fmt::format("{}, line {}: the time \"{}\" is none or goes back",
                                       file_.string(), number_, cells[c]));
        }
        time_s_.push_back(*value);
      } else {
        values_[c].push_back(*value);
      }
    }
  }

  std::filesystem::path file_;
  std::ifstream in_;
  int number_ = 0;  // of the line
  char separator_ = ',';
  std::vector<Heading> headings_;
  std::size_t time_column_ = 0;
  std::vector<double> time_s_;  // in the table's units
  std::vector<std::vector<double>> values_;
};

}  // namespace

std::vector<Channel> ReadChannelTable(const std::filesystem::path& file) {
  return Table(file).Channels();
}

}  // namespace plumbline
