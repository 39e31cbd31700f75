#include "calib/board.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <stdexcept>

#include "calib/error.h"

namespace plumbline {
namespace {

struct KindWord {
  BoardSpec::Kind kind;
  std::string_view name;
  std::string_view example;
  std::size_t fields;
  int least_columns, least_rows;
};

constexpr std::array<KindWord, 6> kKinds = {{
    {BoardSpec::Kind::kChessboard, "chessboard", "chessboard:12x8:5mm", 3, 3, 3},
    {BoardSpec::Kind::kAsymmetricCircles, "acircles", "acircles:4x11:20mm", 3, 2, 3},
    {BoardSpec::Kind::kCircles, "circles", "circles:14x10:7mm", 3, 3, 3},
    {BoardSpec::Kind::kDonutDots, "donut-dots", "donut-dots:14x10:7mm", 3, 6, 6},
    {BoardSpec::Kind::kCharuco, "charuco", "charuco:5x7:36.2mm:18.3mm:DICT_6X6_250", 5, 3, 3},
    {BoardSpec::Kind::kAprilGrid, "aprilgrid", "aprilgrid:6x6:88mm:0.3:tag36h11", 5, 1, 1},
}};

struct Family {
  std::string_view name;
  int markers;
};
constexpr std::array<Family, 21> kArucoDictionaries = {{
    {"DICT_4X4_50", 50},        {"DICT_4X4_100", 100},         {"DICT_4X4_250", 250},
    {"DICT_4X4_1000", 1000},    {"DICT_5X5_50", 50},           {"DICT_5X5_100", 100},
    {"DICT_5X5_250", 250},      {"DICT_5X5_1000", 1000},       {"DICT_6X6_50", 50},
    {"DICT_6X6_100", 100},      {"DICT_6X6_250", 250},         {"DICT_6X6_1000", 1000},
    {"DICT_7X7_50", 50},        {"DICT_7X7_100", 100},         {"DICT_7X7_250", 250},
    {"DICT_7X7_1000", 1000},    {"DICT_ARUCO_ORIGINAL", 1024}, {"DICT_APRILTAG_16h5", 30},
    {"DICT_APRILTAG_25h9", 35}, {"DICT_APRILTAG_36h10", 2320}, {"DICT_APRILTAG_36h11", 587},
}};
constexpr std::array<Family, 4> kTagFamilies = {
    {{"tag36h11", 587}, {"tag36h10", 2320}, {"tag25h9", 35}, {"tag16h5", 30}}};

const KindWord& Describe(BoardSpec::Kind kind) {
  for (const KindWord& k : kKinds) {
    if (k.kind == kind) return k;
  }
  throw std::logic_error("BoardSpec: unknown kind");
}

// Builds the message of every refusal: the word, the fault, a word that works.
struct Refusal {
  std::string_view word;
  std::string_view example;
  [[noreturn]] void operator()(const std::string& fault) const {
    throw UsageError(fmt::format("board '{}': {}; a right word is {}", word, fault, example));
  }
};

std::vector<std::string_view> Split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  for (std::size_t at = 0;;) {
    const std::size_t end = text.find(separator, at);
    parts.push_back(text.substr(at, end - at));
    if (end == std::string_view::npos) return parts;
    at = end + 1;
  }
}

template <typename T>
std::optional<T> ReadNumber(std::string_view text, std::string_view* rest = nullptr) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc()) return std::nullopt;
  const std::string_view left = text.substr(static_cast<std::size_t>(end - text.data()));
  if (rest != nullptr) {
    *rest = left;
  } else if (!left.empty()) {
    return std::nullopt;
  }
  return value;
}

double ReadLengthMm(std::string_view text, std::string_view what, const Refusal& refuse) {
  std::string_view unit;
  const std::optional<double> value = ReadNumber<double>(text, &unit);
  if (!value) refuse(fmt::format("'{}' is not {}", text, what));
  double mm = 0;
  if (unit == "mm") {
    mm = *value;
  } else if (unit == "cm") {
    mm = *value * 10;
  } else if (unit == "m") {
    mm = *value * 1000;
  } else if (unit.empty()) {
    refuse(fmt::format("{} '{}' has no unit (mm, cm or m)", what, text));
  } else {
    refuse(fmt::format("{} '{}' has the unit '{}', known are mm, cm and m", what, text, unit));
  }
  if (!std::isfinite(mm) || mm <= 0) refuse(fmt::format("{} '{}' is not positive", what, text));
  return mm;
}

void ReadSize(std::string_view text, const KindWord& kind, const Refusal& refuse, BoardSpec& spec) {
  const auto sides = Split(text, 'x');
  const auto columns = ReadNumber<int>(sides[0]);
  const auto rows = sides.size() == 2 ? ReadNumber<int>(sides[1]) : std::nullopt;
  if (!columns || !rows) refuse(fmt::format("'{}' is not a size, columns x rows", text));
  if (*columns < kind.least_columns || *rows < kind.least_rows) {
    refuse(fmt::format("{} is too small, the least for {} is {}x{}", text, kind.name,
                       kind.least_columns, kind.least_rows));
  }
  if (*columns > 1000 || *rows > 1000) {
    refuse(fmt::format("{} is more than 1000 points along a side", text));
  }
  spec.columns = *columns;
  spec.rows = *rows;
}

template <std::size_t N>
void ReadFamily(std::string_view text, const std::array<Family, N>& known, int needed,
                const Refusal& refuse, BoardSpec& spec) {
  for (const Family& family : known) {
    if (family.name != text) continue;
    if (needed > family.markers) {
      refuse(fmt::format("the board needs {} markers and {} has {}", needed, text, family.markers));
    }
    spec.dictionary = text;
    return;
  }
  std::string names;
  for (const Family& family : known) names += fmt::format(" {}", family.name);
  refuse(fmt::format("'{}' is none of{}", text, names));
}

}  // namespace

BoardSpec BoardSpec::Parse(std::string_view word) {
  const auto fields = Split(word, ':');
  const KindWord* kind = nullptr;
  for (const KindWord& k : kKinds) {
    if (k.name == fields[0]) kind = &k;
  }
  if (kind == nullptr) {
    std::string names;
    for (const KindWord& k : kKinds) names += fmt::format(" {}", k.name);
    Refusal{word, kKinds[0].example}(
        fmt::format("'{}' is no kind of board (known:{})", fields[0], names));
  }
  const Refusal refuse{word, kind->example};
  if (fields.size() != kind->fields) {
    refuse(fmt::format("{} fields between colons where {} has {}", fields.size(), kind->name,
                       kind->fields));
  }
  BoardSpec spec;
  spec.kind = kind->kind;
  ReadSize(fields[1], *kind, refuse, spec);
  if (spec.kind == Kind::kCharuco) {
    spec.pitch_mm = ReadLengthMm(fields[2], "the side of a square", refuse);
    spec.marker_mm = ReadLengthMm(fields[3], "the side of a marker", refuse);
    if (spec.marker_mm >= spec.pitch_mm) {
      refuse(fmt::format("markers of {} do not fit in squares of {}", fields[3], fields[2]));
    }
    ReadFamily(fields[4], kArucoDictionaries, spec.columns * spec.rows / 2, refuse, spec);
  } else if (spec.kind == Kind::kAprilGrid) {
    spec.pitch_mm = ReadLengthMm(fields[2], "the side of a tag", refuse);
    const auto ratio = ReadNumber<double>(fields[3]);
    if (!ratio || !(*ratio > 0) || *ratio > 10) {
      refuse(fmt::format("'{}' is not a ratio of gap to tag side between 0 and 10", fields[3]));
    }
    spec.spacing_ratio = *ratio;
    ReadFamily(fields[4], kTagFamilies, spec.columns * spec.rows, refuse, spec);
  } else {
    spec.pitch_mm = ReadLengthMm(fields[2], "the pitch", refuse);
  }
  return spec;
}

std::string BoardSpec::Word() const {
  std::string word = fmt::format("{}:{}x{}:{}mm", Describe(kind).name, columns, rows, pitch_mm);
  if (kind == Kind::kCharuco) word += fmt::format(":{}mm:{}", marker_mm, dictionary);
  if (kind == Kind::kAprilGrid) word += fmt::format(":{}:{}", spacing_ratio, dictionary);
  return word;
}

int BoardSpec::PointCount() const {
  if (kind == Kind::kCharuco) return (columns - 1) * (rows - 1);
  if (kind == Kind::kAprilGrid) return 4 * columns * rows;
  return columns * rows;
}

Eigen::Vector3d BoardSpec::NominalPoint(int id) const {
  if (id < 0 || id >= PointCount()) {
    throw std::out_of_range(fmt::format("{} has no point {}", Word(), id));
  }
  if (kind == Kind::kAprilGrid) {
    const int tag = id / 4, corner = id % 4;
    const bool right = corner == 1 || corner == 2, top = corner >= 2;
    const double step_mm = pitch_mm * (1 + spacing_ratio);
    const int row_from_top = rows - 1 - tag / columns;
    return {(tag % columns) * step_mm + (right ? pitch_mm : 0),
            row_from_top * step_mm + (top ? 0 : pitch_mm), 0};
  }
  const int width = kind == Kind::kCharuco ? columns - 1 : columns;
  const int c = id % width, r = id / width;
  const int x = kind == Kind::kAsymmetricCircles ? 2 * c + r % 2 : c;
  return {x * pitch_mm, r * pitch_mm, 0};
}

int BoardSpec::SymmetryOrder() const {
  switch (kind) {
    case Kind::kCircles:
      return columns == rows ? 4 : 2;
    case Kind::kAsymmetricCircles:
      return rows % 2 == 0 ? 2 : 1;
    case Kind::kChessboard:
      if ((columns + rows) % 2 != 0) return 1;
      // A quarter turn of a square board with an odd count swaps black and white.
      return columns == rows && columns % 2 == 0 ? 4 : 2;
    default:
      return 1;
  }
}

std::optional<int> BoardSpec::HalfTurnId(int id) const {
  if (SymmetryOrder() == 1) return std::nullopt;
  return PointCount() - 1 - id;
}

DonutMarkers MarkersOf(const BoardSpec& spec) {
  if (spec.kind != BoardSpec::Kind::kDonutDots) {
    throw std::invalid_argument("MarkersOf: only donut-dots boards have ring markers");
  }
  const int left = 2, right = spec.columns - 3, top = 2, bottom = spec.rows - 3;
  return {bottom * spec.columns + left, bottom * spec.columns + right, top * spec.columns + left};
}

}  // namespace plumbline
