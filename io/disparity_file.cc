#include "io/disparity_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "calib/error.h"

namespace plumbline {
namespace {

namespace fs = std::filesystem;

constexpr int kLargestSide = 1 << 16;
constexpr std::int64_t kLargestPixelCount = std::int64_t{1} << 28;

void WriteWhole(const fs::path& file, const std::string& bytes) {
  fs::path temporary = file;
  temporary += ".part";
  errno = 0;
  std::ofstream stream(temporary, std::ios::binary);
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  stream.close();
  std::error_code failure;
  if (stream) {
    fs::rename(temporary, file, failure);
    if (!failure) return;
  } else {
    failure = {errno, std::generic_category()};
  }
  std::error_code ignored;
  fs::remove(temporary, ignored);
  throw EnvironmentError(
      fmt::format("{} cannot be written ({}): check the folder and the free space", file.string(),
                  failure.message()));
}

// CRC-32 of PNG (ISO 3309), bit by bit: it covers a hundred bytes.
std::uint32_t Crc(const std::string& bytes) {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

std::string BigEndian(std::uint32_t value) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) {
    bytes += static_cast<char>(static_cast<unsigned char>((value >> shift) & 0xFFU));
  }
  return bytes;
}

std::string TextChunk(const std::string& keyword, const std::string& text) {
  const std::string body = "tEXt" + keyword + '\0' + text;
  return BigEndian(static_cast<std::uint32_t>(body.size() - 4)) + body + BigEndian(Crc(body));
}

float FromBytes(const char* bytes, bool little_endian) {
  std::uint32_t value = 0;
  for (int i = 0; i < 4; ++i) {
    const auto byte = static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[i]));
    value |= byte << (8 * (little_endian ? i : 3 - i));
  }
  return std::bit_cast<float>(value);
}

std::string ReadWhole(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream content;
  content << stream.rdbuf();
  if (!stream) throw InputError(fmt::format("{} cannot be read: check the path", file.string()));
  return content.str();
}

}  // namespace

DisparityPngScale ChooseDisparityPngScale(const Image<float>& disparity_px) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const float d : disparity_px.values()) {
    if (!std::isfinite(d)) continue;
    low = std::min(low, static_cast<double>(d));
    high = std::max(high, static_cast<double>(d));
  }
  DisparityPngScale scale;
  constexpr double kLargestGrey = 65535;
  if (!(low <= high) || (low * 256 >= 1 && high * 256 <= kLargestGrey)) return scale;
  scale.offset_px = std::floor(low) - 1;  // so that the least value is not the grey level of none
  while ((high - scale.offset_px) * scale.steps_per_px > kLargestGrey) scale.steps_per_px /= 2;
  return scale;
}

void WriteDisparityPng(const fs::path& file, const Image<float>& disparity_px,
                       const DisparityPngScale& scale) {
  cv::Mat1w grey(disparity_px.height(), disparity_px.width(), ushort{0});
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      const auto d = static_cast<double>(disparity_px(y, x));
      if (!std::isfinite(d)) continue;
      const double level = std::round((d - scale.offset_px) * scale.steps_per_px);
      if (!(level >= 1 && level <= 65535)) {
        throw UsageError(
            fmt::format("disparity {} px at column {}, row {} does not fit a 16-bit PNG of {} "
                        "steps a px from {} "
                        "px: choose another scale",
                        d, x, y, scale.steps_per_px, scale.offset_px));
      }
      grey(y, x) = static_cast<ushort>(level);
    }
  }
  std::vector<uchar> encoded;
  if (grey.empty() || !cv::imencode(".png", grey, encoded)) {
    throw UsageError(fmt::format("{}: an empty disparity map cannot be written", file.string()));
  }
  std::string bytes(encoded.begin(), encoded.end());
  constexpr std::size_t kAfterHeader = 8 + 25;  // signature and the IHDR chunk
  bytes.insert(
      kAfterHeader,
      TextChunk("Description",
                fmt::format("disparity_px = grey / {} + {}; grey 0: no value; left pixel (x, "
                            "y) matches right pixel (x - disparity_px, y)",
                            scale.steps_per_px, scale.offset_px)));
  WriteWhole(file, bytes);
}

void WritePfm(const fs::path& file, const Image<float>& image) {
  std::string bytes = fmt::format("Pf\n{} {}\n-1.0\n", image.width(), image.height());
  bytes.reserve(bytes.size() + 4 * image.pixel_count());
  for (int y = image.height() - 1; y >= 0; --y) {
    for (int x = 0; x < image.width(); ++x) {
      float value = image(y, x);
      if (!std::isfinite(value)) value = std::numeric_limits<float>::infinity();
      const auto raw = std::bit_cast<std::uint32_t>(value);
      for (int shift = 0; shift < 32; shift += 8) {
        bytes += static_cast<char>(static_cast<unsigned char>((raw >> shift) & 0xFFU));
      }
    }
  }
  WriteWhole(file, bytes);
}

Image<float> ReadPfm(const fs::path& file) {
  const std::string bytes = ReadWhole(file);
  std::istringstream header(bytes.substr(0, 200));
  std::string magic;
  ImageSize size;
  double order = 0;
  header >> magic >> size.width >> size.height >> order;
  if (magic == "PF") {
    throw InputError(fmt::format("{} is a colour float map (PF): give one with one channel (Pf)",
                                 file.string()));
  }
  if (!header || magic != "Pf" || order == 0 || !std::isfinite(order) || size.width <= 0 ||
      size.height <= 0 || size.width > kLargestSide || size.height > kLargestSide ||
      std::int64_t{size.width} * size.height > kLargestPixelCount) {
    throw InputError(
        fmt::format("{} is no portable float map: its header must be Pf, width, height "
                    "and byte order",
                    file.string()));
  }
  const std::size_t start = static_cast<std::size_t>(header.tellg()) + 1;
  const std::size_t count =
      static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height);
  if (bytes.size() < start + 4 * count) {
    throw InputError(fmt::format(
        "{} is cut off: {} x {} px need {} bytes after the header, {} are there", file.string(),
        size.width, size.height, 4 * count, bytes.size() - std::min(bytes.size(), start)));
  }
  Image<float> image(size);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t row = i / static_cast<std::size_t>(size.width);
    const std::size_t column = i % static_cast<std::size_t>(size.width);
    const float value = FromBytes(bytes.data() + start + 4 * i, order < 0);
    image(size.height - 1 - static_cast<int>(row), static_cast<int>(column)) =
        std::isfinite(value) ? value : std::numeric_limits<float>::quiet_NaN();
  }
  return image;
}

}  // namespace plumbline
