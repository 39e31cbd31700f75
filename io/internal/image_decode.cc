#include "io/internal/image_decode.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string_view>
#include <vector>

#include "calib/error.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

FilePointer OpenForReading(const fs::path& file) {
  std::error_code ignored;
  if (fs::is_directory(file, ignored)) {
    throw InputError(fmt::format("{} is a folder, not an image", file.string()));
  }
  FilePointer f(std::fopen(file.c_str(), "rb"));
  if (!f) {
    throw InputError(fmt::format("{} cannot be opened: {}", file.string(), std::strerror(errno)));
  }
  return f;
}

void RefuseImage(const fs::path& file, const std::string& fault) {
  throw InputError(fmt::format("{}: {}", file.string(), fault));
}

ImageSize CheckedSize(const fs::path& file, std::int64_t width, std::int64_t height,
                      std::int64_t max_pixels) {
  if (width <= 0 || height <= 0 || width > INT32_MAX || height > INT32_MAX) {
    RefuseImage(
        file, fmt::format("its header gives the size {} x {}: the file is damaged", width, height));
  }
  if (width > max_pixels / height) {
    RefuseImage(file, fmt::format("{} x {} pixels are more than the {} that are allowed; crop the "
                                  "image or raise the limit",
                                  width, height, max_pixels));
  }
  return {static_cast<int>(width), static_cast<int>(height)};
}

int SignificantBits(const Image<std::uint16_t>& grey, int stored_bits, int stated_bits) {
  if (stored_bits <= 8) return 8;
  const auto& v = grey.values();
  const int brightest = v.empty() ? 0 : *std::max_element(v.begin(), v.end());
  if (stated_bits >= 8 && stated_bits <= stored_bits && brightest < (1 << stated_bits)) {
    return stated_bits;
  }
  for (const int bits : {8, 10, 12, 14}) {
    if (brightest < (1 << bits) && stated_bits == 0) return bits;
  }
  return 16;
}

namespace {

DecodedImage FromOpenCv(const cv::Mat& mat) {
  DecodedImage out;
  out.was_colour = mat.channels() >= 3;
  out.image.grey = Image<std::uint16_t>({mat.cols, mat.rows});
  for (int r = 0; r < mat.rows; ++r) {
    const unsigned char* in = mat.ptr<unsigned char>(r);
    std::uint16_t* to = out.image.grey.row(r);
    for (int c = 0; c < mat.cols; ++c) {
      to[c] = mat.channels() == 1 ? in[c] : GreyFromRgb(in[3 * c + 2], in[3 * c + 1], in[3 * c]);
    }
  }
  return out;
}

// The next number of a PNM header; comments run from # to the end of the line.
int PnmNumber(const fs::path& file, std::FILE* f) {
  int c = std::fgetc(f);
  while (c == '#' || std::isspace(c)) {
    if (c == '#') {
      while (c != '\n' && c != EOF) c = std::fgetc(f);
    } else {
      c = std::fgetc(f);
    }
  }
  std::int64_t value = -1;
  for (; c >= '0' && c <= '9' && value < INT32_MAX; c = std::fgetc(f)) {
    value = 10 * std::max<std::int64_t>(value, 0) + (c - '0');
  }
  if (value < 0 || value > INT32_MAX || !std::isspace(c))
    RefuseImage(file, "its header is damaged");
  return static_cast<int>(value);
}

}  // namespace

DecodedImage DecodeBmp(const fs::path& file, std::int64_t max_pixels) {
  std::array<unsigned char, 54> head{};
  {
    const FilePointer f = OpenForReading(file);
    if (std::fread(head.data(), 1, head.size(), f.get()) != head.size()) {
      RefuseImage(file, "the file is truncated");
    }
  }
  const auto u32 = [&](std::size_t at) {
    std::uint32_t v = 0;
    std::memcpy(&v, head.data() + at, 4);
    return v;
  };
  const auto width = static_cast<std::int32_t>(u32(18));
  const auto height = std::abs(static_cast<std::int64_t>(static_cast<std::int32_t>(u32(22))));
  CheckedSize(file, width, height, max_pixels);
  const std::int64_t bits = head[28] + 256 * head[29];
  const std::int64_t stride = (width * bits + 31) / 32 * 4;
  // Checked here because OpenCV prints its own complaints to the terminal.
  if ((bits != 8 && bits != 24 && bits != 32) || u32(30) != 0) {
    RefuseImage(file, "this kind of BMP is not read, or the file is damaged; save it as PNG");
  }
  if (u32(14) < 40 || u32(46) > 256) RefuseImage(file, "the BMP file is damaged");
  if (static_cast<std::int64_t>(fs::file_size(file)) < u32(10) + stride * height) {
    RefuseImage(file, "the BMP file is truncated");
  }
  cv::Mat mat;
  try {
    mat = cv::imread(file.string(), bits <= 8 ? cv::IMREAD_ANYCOLOR : cv::IMREAD_COLOR);
  } catch (const cv::Exception&) {
    mat = cv::Mat();
  }
  if (mat.empty() || mat.depth() != CV_8U) RefuseImage(file, "the BMP file is damaged");
  return FromOpenCv(mat);
}

DecodedImage DecodePnm(const fs::path& file, std::int64_t max_pixels) {
  const FilePointer f = OpenForReading(file);
  std::fgetc(f.get());
  const int kind = std::fgetc(f.get());
  const int width = PnmNumber(file, f.get());
  const int height = PnmNumber(file, f.get());
  const ImageSize size = CheckedSize(file, width, height, max_pixels);
  const int maxval = PnmNumber(file, f.get());
  if (maxval < 1 || maxval > 65535) RefuseImage(file, "its header is damaged");
  const std::size_t channels = kind == '6' ? 3 : 1;
  const std::size_t bytes = maxval > 255 ? 2 : 1;
  std::vector<unsigned char> row(static_cast<std::size_t>(width) * channels * bytes);
  DecodedImage out;
  out.was_colour = channels == 3;
  out.image.grey = Image<std::uint16_t>(size);
  for (int r = 0; r < height; ++r) {
    if (std::fread(row.data(), 1, row.size(), f.get()) != row.size()) {
      RefuseImage(file, fmt::format("the file is truncated after {} of its {} rows", r, height));
    }
    for (std::size_t c = 0; c < static_cast<std::size_t>(width); ++c) {
      const auto sample = [&](std::size_t k) -> unsigned {
        const unsigned char* at = row.data() + (c * channels + k) * bytes;
        return bytes == 2 ? at[0] * 256u + at[1] : at[0];
      };
      out.image.grey.row(r)[c] = channels == 1 ? static_cast<std::uint16_t>(sample(0))
                                               : GreyFromRgb(sample(0), sample(1), sample(2));
    }
  }
  int stated = 8;
  while (maxval >= (1 << stated)) ++stated;
  out.image.bits = SignificantBits(out.image.grey, bytes == 2 ? 16 : 8, stated);
  return out;
}

DecodedImage DecodeImage(const fs::path& file, std::int64_t max_pixels) {
  std::array<char, 8> head{};
  {
    const FilePointer f = OpenForReading(file);
    const std::size_t n = std::fread(head.data(), 1, head.size(), f.get());
    if (n == 0) RefuseImage(file, "the file is empty");
  }
  const std::string_view magic(head.data(), head.size());
  const auto starts = [&](std::string_view with) { return magic.substr(0, with.size()) == with; };
  if (starts("\x89PNG\r\n\x1a\n")) return DecodePng(file, max_pixels);
  if (starts("\xff\xd8\xff")) return DecodeJpeg(file, max_pixels);
  if (starts(std::string_view("II*\0", 4)) || starts(std::string_view("MM\0*", 4)) ||
      starts(std::string_view("II+\0", 4)) || starts(std::string_view("MM\0+", 4))) {
    return DecodeTiff(file, max_pixels);
  }
  if (starts("BM")) return DecodeBmp(file, max_pixels);
  if (starts("P5") || starts("P6")) return DecodePnm(file, max_pixels);
  RefuseImage(file, "not an image of a known format; use PNG, TIFF, JPEG, BMP or binary PGM/PPM");
}

}  // namespace plumbline::internal
