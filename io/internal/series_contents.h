#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace plumbline::internal {

// What a series may hold beside what every series of its kind holds. Contents: a struct of flags,
// SeriesContents or PlanarContents. The place in its table is the bit in the journal.
template <typename Contents>
struct OptionalContent {
  std::string_view name;
  std::string_view path;  // it is there where a file has this group or dataset
  bool Contents::*flag;
};

// Specialised for each kind of contents: `list`, an array of OptionalContent.
template <typename Contents>
struct OptionalContents;

// 0: for null, which every series holds.
template <typename Contents>
constexpr std::uint32_t BitOf(bool Contents::*flag) {
  std::uint32_t bit = 1;
  for (const OptionalContent<Contents>& content : OptionalContents<Contents>::list) {
    if (content.flag == flag) return bit;
    bit <<= 1;
  }
  return 0;
}

template <typename Contents>
std::uint32_t BitsOf(const Contents& contents) {
  std::uint32_t bits = 0;
  for (const OptionalContent<Contents>& content : OptionalContents<Contents>::list) {
    if (contents.*content.flag) bits |= BitOf(content.flag);
  }
  return bits;
}

template <typename Contents>
Contents FromBits(std::uint32_t bits) {
  Contents contents;
  for (const OptionalContent<Contents>& content : OptionalContents<Contents>::list) {
    contents.*content.flag = (bits & BitOf(content.flag)) != 0;
  }
  return contents;
}

template <typename Contents>
std::vector<std::string> NamesOf(const Contents& contents) {
  std::vector<std::string> names;
  for (const OptionalContent<Contents>& content : OptionalContents<Contents>::list) {
    if (contents.*content.flag) names.emplace_back(content.name);
  }
  return names;
}

}  // namespace plumbline::internal
