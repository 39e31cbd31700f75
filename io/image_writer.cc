#include "io/image_writer.h"

#include <fmt/format.h>
#include <png.h>

#include <csetjmp>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <vector>

#include "calib/error.h"
#include "io/internal/durable_file.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

constexpr int kCompression = 3;  // sensor noise does not get smaller with more

struct PngEncoder {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::vector<char> bytes;

  PngEncoder() {
    png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
    if (png != nullptr) info = png_create_info_struct(png);
    if (info == nullptr) throw std::bad_alloc();
    png_set_write_fn(png, this, Append, nullptr);
  }
  PngEncoder(const PngEncoder&) = delete;
  PngEncoder& operator=(const PngEncoder&) = delete;
  ~PngEncoder() { png_destroy_write_struct(&png, &info); }

  static void Append(png_structp png, png_bytep data, png_size_t size) {
    auto& bytes = static_cast<PngEncoder*>(png_get_io_ptr(png))->bytes;
    bytes.insert(bytes.end(), data, data + size);
  }

  // `rows` are as PNG stores them. False when libpng gave up, which it does by longjmp.
  bool Encode(const GrayImage& image, int stored_bits, std::vector<png_bytep>& rows) {
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    png_set_compression_level(png, kCompression);
    png_set_IHDR(png, info, static_cast<png_uint_32>(image.width()),
                 static_cast<png_uint_32>(image.height()), stored_bits, PNG_COLOR_TYPE_GRAY,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (stored_bits == 16) {
      png_color_8 significant{};
      significant.gray = static_cast<png_byte>(image.bits);
      png_set_sBIT(png, info, &significant);
    }
    png_write_info(png, info);
    png_write_image(png, rows.data());
    png_write_end(png, nullptr);
    return true;
  }
};

}  // namespace

void WritePng(const fs::path& file, const GrayImage& image) {
  const int stored_bits = image.bits > 8 ? 16 : 8;
  const std::size_t row_bytes = static_cast<std::size_t>(image.width() * stored_bits / 8);
  std::vector<unsigned char> stored(row_bytes * static_cast<std::size_t>(image.height()));
  std::vector<png_bytep> rows;
  for (int r = 0; r < image.height(); ++r) {
    unsigned char* row = stored.data() + static_cast<std::size_t>(r) * row_bytes;
    rows.push_back(row);
    for (int c = 0; c < image.width(); ++c) {
      const std::uint16_t grey = image.grey(r, c);
      if (stored_bits == 16) *row++ = static_cast<unsigned char>(grey >> 8);
      *row++ = static_cast<unsigned char>(grey & 0xff);
    }
  }
  PngEncoder encoder;
  if (!encoder.Encode(image, stored_bits, rows)) throw std::bad_alloc();
  internal::WriteBytes(file, encoder.bytes);
}

struct VideoWriter::Impl {
  fs::path file;
  ImageSize size;
  cv::VideoWriter writer;
  std::int64_t added = 0;
};

void VideoWriter::CheckRate(double frames_per_second) {
  if (!(frames_per_second >= 0.1 && frames_per_second <= 1e5)) {
    throw UsageError("A video has 0.1 to 100000 frames a second; write PNG images instead.");
  }
}

VideoWriter::VideoWriter(const fs::path& file, ImageSize size, double frames_per_second)
    : impl_(std::make_unique<Impl>()) {
  if (file.extension() != ".mkv" && file.extension() != ".avi") {
    throw UsageError(
        fmt::format("A video is written to a .mkv or .avi file, not to '{}'.", file.string()));
  }
  CheckRate(frames_per_second);
  impl_->file = file;
  impl_->size = size;
  const bool opened = impl_->writer.open(
      file.string(), cv::CAP_FFMPEG, cv::VideoWriter::fourcc('F', 'F', 'V', '1'), frames_per_second,
      cv::Size(size.width, size.height), {cv::VIDEOWRITER_PROP_IS_COLOR, 0});
  if (!opened) {
    throw EnvironmentError(fmt::format(
        "The video '{}' cannot be written; is its folder there and writable?", file.string()));
  }
}

VideoWriter::~VideoWriter() = default;

void VideoWriter::Add(const GrayImage& image) {
  if (image.size() != impl_->size) {
    throw std::invalid_argument("VideoWriter: an image is not of the video's size");
  }
  if (image.bits != 8) {
    throw UsageError("Videos hold 8 bits a pixel; write PNG images to keep more.");
  }
  cv::Mat grey(image.height(), image.width(), CV_8UC1);
  for (int r = 0; r < image.height(); ++r) {
    for (int c = 0; c < image.width(); ++c) {
      grey.at<std::uint8_t>(r, c) = static_cast<std::uint8_t>(image.grey(r, c));
    }
  }
  impl_->writer.write(grey);
  ++impl_->added;
}

void VideoWriter::Close() {
  impl_->writer.release();
  // OpenCV does not tell of a full disk.
  const cv::VideoCapture written(impl_->file.string(), cv::CAP_FFMPEG);
  const auto held =
      written.isOpened() ? static_cast<std::int64_t>(written.get(cv::CAP_PROP_FRAME_COUNT)) : 0;
  if (held != impl_->added) {
    throw EnvironmentError(fmt::format("The video '{}' holds {} of {} frames; is the disk full?",
                                       impl_->file.string(), held, impl_->added));
  }
}

}  // namespace plumbline
