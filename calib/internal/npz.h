#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace plumbline::internal {

// One numpy array of an .npz archive, in C order. A scalar has an empty shape.
struct NpyArray {
  std::vector<std::int64_t> shape;
  // Exactly one of these kinds; a string stands for an array of shape () and numpy type <U.
  std::variant<std::vector<double>, std::vector<std::int64_t>, std::vector<bool>, std::string>
      values;
};

using NpzArchive = std::map<std::string, NpyArray>;

// The bytes of an .npz archive as numpy.savez_compressed() makes: float64 for doubles, int32 for
// integers, bool and unicode strings. Throws std::logic_error if a shape and its values disagree.
std::string WriteNpz(const NpzArchive& archive);

// Reads such bytes; float32, float64, all integer types up to 64 bits, bool, <U and S strings.
// `name` is for messages. Throws InputError when it is no such archive or an entry is damaged;
// nothing is unpickled.
NpzArchive ReadNpz(std::string_view bytes, const std::string& name);

// Python's base64.b85encode() and b85decode() (RFC 1924 alphabet, groups of four bytes,
// big-endian). Decoding throws InputError at a character that is not of the alphabet.
std::string EncodeBase85(std::string_view bytes);
std::string DecodeBase85(std::string_view text, const std::string& name);

}  // namespace plumbline::internal
