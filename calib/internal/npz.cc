#include "calib/internal/npz.h"

#include <zip.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <memory>
#include <stdexcept>

#include "calib/error.h"
#include "calib/internal/python_literal.h"

namespace plumbline::internal {
namespace {

constexpr std::uint64_t kMaxEntryBytes = std::uint64_t{1} << 30;
constexpr std::string_view kNpyMagic = "\x93NUMPY";
constexpr std::string_view kAlphabet =
    "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;<=>?@^_`{|}~";

template <typename T>
void Append(std::string& out, T value) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));  // little-endian, as all machines Debian 12 supports here
  out.append(bytes, sizeof(T));
}

// numpy's .npy format, version 1.0: magic, version, header length, a Python dict, the values.
std::string WriteNpy(const NpyArray& array) {
  std::size_t expected = 1;
  std::string shape;
  for (const std::int64_t n : array.shape) {
    expected *= static_cast<std::size_t>(n);
    shape += std::to_string(n) + ", ";
  }
  std::string data, type;
  std::size_t count = 1;
  if (const auto* doubles = std::get_if<std::vector<double>>(&array.values)) {
    type = "<f8";
    count = doubles->size();
    for (const double v : *doubles) Append(data, v);
  } else if (const auto* integers = std::get_if<std::vector<std::int64_t>>(&array.values)) {
    type = "<i4";
    count = integers->size();
    for (const std::int64_t v : *integers) Append(data, static_cast<std::int32_t>(v));
  } else if (const auto* bools = std::get_if<std::vector<bool>>(&array.values)) {
    type = "|b1";
    count = bools->size();
    for (const bool v : *bools) data += v ? '\1' : '\0';
  } else {
    const auto& text = std::get<std::string>(array.values);
    // numpy has no string of length 0: '' is one NUL character.
    type = "<U" + std::to_string(std::max<std::size_t>(1, text.size()));
    for (const char c : text)
      Append(data, static_cast<std::uint32_t>(static_cast<unsigned char>(c)));
    if (text.empty()) Append(data, std::uint32_t{0});
  }
  if (count != expected) throw std::logic_error("npz: values do not fill the shape");
  std::string header =
      "{'descr': '" + type + "', 'fortran_order': False, 'shape': (" + shape + "), }";
  header.append(64 - (10 + header.size() + 1) % 64, ' ');
  header += '\n';
  std::string out(kNpyMagic);
  out += '\1';
  out += '\0';
  Append(out, static_cast<std::uint16_t>(header.size()));
  return out + header + data;
}

template <typename T>
T Read(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof(T));
  return value;
}

// How many bytes one value of a numpy type takes, and whether it is text.
struct NumpyType {
  char kind = 0;  // f, i, u, b, U, S
  std::size_t bytes = 0;
};

NumpyType ParseType(const std::string& descr, const std::string& name) {
  NumpyType type;
  if (descr.size() >= 3 && descr[0] != '>') {
    type.kind = descr[1];
    type.bytes = static_cast<std::size_t>(std::strtoul(descr.c_str() + 2, nullptr, 10));
  }
  const std::size_t n = type.bytes;
  const bool supported =
      (type.kind == 'f' && (n == 4 || n == 8)) || (type.kind == 'b' && n == 1) ||
      ((type.kind == 'i' || type.kind == 'u') && (n == 1 || n == 2 || n == 4 || n == 8)) ||
      ((type.kind == 'U' || type.kind == 'S') && n > 0 && n < 4096);
  if (!supported) throw InputError(name + ": numpy type '" + descr + "' is not supported");
  if (type.kind == 'U') type.bytes *= 4;
  return type;
}

// Each branch by itself: a ?: between signed and unsigned would turn -1 into 2^32 - 1.
double ReadNumber(const NumpyType& type, const char* at) {
  if (type.kind == 'f') return type.bytes == 4 ? Read<float>(at) : Read<double>(at);
  if (type.kind == 'i') {
    if (type.bytes == 1) return Read<std::int8_t>(at);
    if (type.bytes == 2) return Read<std::int16_t>(at);
    if (type.bytes == 4) return Read<std::int32_t>(at);
    return static_cast<double>(Read<std::int64_t>(at));
  }
  if (type.bytes == 1) return Read<std::uint8_t>(at);
  if (type.bytes == 2) return Read<std::uint16_t>(at);
  if (type.bytes == 4) return Read<std::uint32_t>(at);
  return static_cast<double>(Read<std::uint64_t>(at));
}

std::string ReadText(const NumpyType& type, const char* at) {
  std::string text;
  const std::size_t step = type.kind == 'U' ? 4 : 1;
  for (std::size_t i = 0; i < type.bytes; i += step) {
    const std::uint32_t c = step == 4 ? Read<std::uint32_t>(at + i) : Read<std::uint8_t>(at + i);
    if (c == 0) break;
    text += c < 128 ? static_cast<char>(c) : '?';
  }
  return text;
}

// Where the k-th value in C order stands in an array stored in Fortran order.
std::size_t FortranIndex(std::size_t k, const std::vector<std::int64_t>& shape) {
  std::size_t index = 0;
  for (std::size_t d = shape.size(); d-- > 0;) {
    const auto n = static_cast<std::size_t>(shape[d]);
    std::size_t stride = 1;
    for (std::size_t e = 0; e < d; ++e) stride *= static_cast<std::size_t>(shape[e]);
    index += (k % n) * stride;
    k /= n;
  }
  return index;
}

struct NpyHeader {
  NumpyType type;
  bool fortran = false;
  std::size_t count = 1;
  std::string_view data;
};

NpyHeader ParseHeader(std::string_view bytes, NpyArray& out, const std::string& name) {
  if (bytes.size() < 12 || bytes.substr(0, 6) != kNpyMagic)
    throw InputError(name + ": no numpy array");
  const bool long_header = bytes[6] >= 2;
  const std::size_t start = long_header ? 12 : 10;
  const std::size_t length =
      long_header ? Read<std::uint32_t>(bytes.data() + 8) : Read<std::uint16_t>(bytes.data() + 8);
  if (length > bytes.size() - start) throw InputError(name + ": the numpy header is cut short");
  const PythonValue header = ParsePythonLiteral(bytes.substr(start, length), name);
  const PythonValue* descr = header.Find("descr");
  const PythonValue* fortran = header.Find("fortran_order");
  const PythonValue* shape = header.Find("shape");
  if (descr == nullptr || descr->AsString() == nullptr || fortran == nullptr ||
      fortran->AsBool() == nullptr || shape == nullptr || shape->AsList() == nullptr) {
    throw InputError(name + ": the numpy header is not understood");
  }
  NpyHeader parsed;
  parsed.type = ParseType(*descr->AsString(), name);
  parsed.fortran = *fortran->AsBool();
  for (const PythonValue& n : *shape->AsList()) {
    const double* size = n.AsNumber();
    if (size == nullptr || *size < 0 || *size > 1e9 ||
        static_cast<double>(parsed.count) * *size > static_cast<double>(kMaxEntryBytes)) {
      throw InputError(name + ": the numpy shape is not understood");
    }
    out.shape.push_back(static_cast<std::int64_t>(*size));
    parsed.count *= static_cast<std::size_t>(*size);
  }
  parsed.data = bytes.substr(start + length);
  if (parsed.data.size() < parsed.count * parsed.type.bytes) {
    throw InputError(name + ": the numpy array is cut short");
  }
  return parsed;
}

NpyArray ReadNpy(std::string_view bytes, const std::string& name) {
  NpyArray out;
  const NpyHeader header = ParseHeader(bytes, out, name);
  const NumpyType& type = header.type;
  if (type.kind == 'U' || type.kind == 'S') {
    if (header.count != 1) throw InputError(name + ": arrays of strings are not supported");
    out.values = ReadText(type, header.data.data());
    return out;
  }
  std::vector<double> doubles(header.count);
  for (std::size_t k = 0; k < header.count; ++k) {
    const std::size_t i = header.fortran ? FortranIndex(k, out.shape) : k;
    doubles[k] = ReadNumber(type, header.data.data() + i * type.bytes);
  }
  if (type.kind == 'f') {
    out.values = std::move(doubles);
  } else if (type.kind == 'b') {
    std::vector<bool> bools(header.count);
    for (std::size_t k = 0; k < header.count; ++k) bools[k] = doubles[k] != 0;
    out.values = std::move(bools);
  } else {
    std::vector<std::int64_t> integers(header.count);
    for (std::size_t k = 0; k < header.count; ++k)
      integers[k] = static_cast<std::int64_t>(doubles[k]);
    out.values = std::move(integers);
  }
  return out;
}

struct ZipDiscard {
  void operator()(zip_t* archive) const { zip_discard(archive); }
};
struct SourceFree {
  void operator()(zip_source_t* source) const { zip_source_free(source); }
};
using SourcePtr = std::unique_ptr<zip_source_t, SourceFree>;

}  // namespace

std::string WriteNpz(const NpzArchive& archive) {
  const auto require = [](bool ok) {
    if (!ok) throw std::runtime_error("npz: libzip failed to build the archive in memory");
  };
  zip_error_t error;
  zip_error_init(&error);
  SourcePtr source(zip_source_buffer_create(nullptr, 0, 0, &error));
  require(source != nullptr);
  zip_source_keep(source.get());  // the archive takes one reference, the bytes are read from ours
  std::vector<std::string> entries;
  entries.reserve(archive.size());  // libzip reads these when it closes: they may not move
  zip_t* zip = zip_open_from_source(source.get(), ZIP_TRUNCATE, &error);
  require(zip != nullptr);
  for (const auto& [name, array] : archive) {
    entries.push_back(WriteNpy(array));
    zip_source_t* entry = zip_source_buffer(zip, entries.back().data(), entries.back().size(), 0);
    const zip_int64_t index = zip_file_add(zip, (name + ".npy").c_str(), entry, ZIP_FL_ENC_UTF_8);
    require(entry != nullptr && index >= 0);
    zip_file_set_mtime(zip, static_cast<zip_uint64_t>(index), 315619200, 0);  // 1980: same bytes
  }
  require(zip_close(zip) == 0);
  require(zip_source_open(source.get()) == 0);
  zip_source_seek(source.get(), 0, SEEK_END);
  std::string bytes(static_cast<std::size_t>(zip_source_tell(source.get())), '\0');
  zip_source_seek(source.get(), 0, SEEK_SET);
  require(zip_source_read(source.get(), bytes.data(), bytes.size()) ==
          static_cast<zip_int64_t>(bytes.size()));
  zip_source_close(source.get());
  return bytes;
}

NpzArchive ReadNpz(std::string_view bytes, const std::string& name) {
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t* source = zip_source_buffer_create(bytes.data(), bytes.size(), 0, &error);
  zip_t* opened = source == nullptr
                      ? nullptr
                      : zip_open_from_source(source, ZIP_RDONLY | ZIP_CHECKCONS, &error);
  if (opened == nullptr) {
    if (source != nullptr) zip_source_free(source);
    throw InputError(name + ": the .npz archive in it is damaged");
  }
  const std::unique_ptr<zip_t, ZipDiscard> zip(opened);
  NpzArchive archive;
  const zip_int64_t count = zip_get_num_entries(zip.get(), 0);
  for (zip_int64_t i = 0; i < count; ++i) {
    zip_stat_t stat;
    zip_stat_init(&stat);
    const auto index = static_cast<zip_uint64_t>(i);
    if (zip_stat_index(zip.get(), index, 0, &stat) != 0 || (stat.valid & ZIP_STAT_SIZE) == 0 ||
        stat.size > kMaxEntryBytes) {
      throw InputError(name + ": the .npz archive in it is damaged");
    }
    std::string key = stat.name;
    std::string data(stat.size, '\0');
    zip_file_t* file = zip_fopen_index(zip.get(), index, 0);
    // libzip compares the CRC only when it meets the end of the data: hence one more byte.
    char beyond = 0;
    const bool sound =
        file != nullptr &&
        zip_fread(file, data.data(), data.size()) == static_cast<zip_int64_t>(data.size()) &&
        zip_fread(file, &beyond, 1) == 0;
    if (file != nullptr) zip_fclose(file);
    if (!sound) throw InputError(name + ": entry '" + key + "' of its .npz archive is damaged");
    if (key.size() > 4 && key.substr(key.size() - 4) == ".npy") key.resize(key.size() - 4);
    archive[key] = ReadNpy(data, name + ", entry '" + key + "'");
  }
  return archive;
}

std::string EncodeBase85(std::string_view bytes) {
  std::string out;
  out.reserve((bytes.size() + 3) / 4 * 5);
  for (std::size_t i = 0; i < bytes.size(); i += 4) {
    const std::size_t n = std::min<std::size_t>(4, bytes.size() - i);
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      word = word << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    }
    std::array<char, 5> digits;
    for (std::size_t k = 5; k-- > 0; word /= 85) digits[k] = kAlphabet[word % 85];
    out.append(digits.data(), n + 1);
  }
  return out;
}

std::string DecodeBase85(std::string_view text, const std::string& name) {
  std::array<int, 256> value;
  value.fill(-1);
  for (std::size_t k = 0; k < kAlphabet.size(); ++k) {
    value[static_cast<unsigned char>(kAlphabet[k])] = static_cast<int>(k);
  }
  std::string out;
  out.reserve(text.size() / 5 * 4 + 4);
  for (std::size_t i = 0; i < text.size(); i += 5) {
    const std::size_t n = std::min<std::size_t>(5, text.size() - i);
    std::uint64_t word = 0;
    for (std::size_t k = 0; k < 5; ++k) {
      const int digit = k < n ? value[static_cast<unsigned char>(text[i + k])] : 84;
      if (digit < 0) throw InputError(name + ": optimization_inputs holds what is no base-85 text");
      word = word * 85 + static_cast<std::uint64_t>(digit);
    }
    if (word > std::numeric_limits<std::uint32_t>::max() || n == 1) {
      throw InputError(name + ": optimization_inputs is cut short or damaged");
    }
    for (std::size_t k = 0; k + 1 < n; ++k) {
      out += static_cast<char>(word >> (24 - 8 * k) & 0xff);
    }
  }
  return out;
}

}  // namespace plumbline::internal
