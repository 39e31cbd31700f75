#pragma once

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "calib/image.h"

namespace plumbline::internal {

// One image file, decoded strictly: what the format's own library warns about is refused.
struct DecodedImage {
  GrayImage image;
  bool was_colour = false;
  std::string note;  // empty, or what the user should know, without the file's name
};

// Reads PNG, TIFF, JPEG, BMP and PGM/PPM by their first bytes, whatever the file is called. Grey
// levels are never scaled; a 16-bit file has the number of bits that it states (PNG sBIT, TIFF
// MaxSampleValue, PGM maxval), or else the smallest of 8, 10, 12, 14 and 16 that holds its
// brightest pixel. Colour becomes grey by the Rec. 601 weights. Orientation tags are not applied:
// pixels stay where the sensor had them.
// Throws InputError naming file and fault, before any memory is taken if the image is larger than
// max_pixels.
DecodedImage DecodeImage(const std::filesystem::path& file, std::int64_t max_pixels);

// What the decoders share.
struct CloseFile {
  void operator()(std::FILE* f) const { std::fclose(f); }
};
using FilePointer = std::unique_ptr<std::FILE, CloseFile>;

FilePointer OpenForReading(const std::filesystem::path& file);
[[noreturn]] void RefuseImage(const std::filesystem::path& file, const std::string& fault);
// Throws InputError when the size is empty or larger than the cap.
ImageSize CheckedSize(const std::filesystem::path& file, std::int64_t width, std::int64_t height,
                      std::int64_t max_pixels);
// stated_bits: 0 if the file states none.
int SignificantBits(const Image<std::uint16_t>& grey, int stored_bits, int stated_bits);

inline std::uint16_t GreyFromRgb(unsigned r, unsigned g, unsigned b) {
  return static_cast<std::uint16_t>((299u * r + 587u * g + 114u * b + 500u) / 1000u);
}

DecodedImage DecodePng(const std::filesystem::path& file, std::int64_t max_pixels);
DecodedImage DecodeJpeg(const std::filesystem::path& file, std::int64_t max_pixels);
DecodedImage DecodeTiff(const std::filesystem::path& file, std::int64_t max_pixels);
DecodedImage DecodeBmp(const std::filesystem::path& file, std::int64_t max_pixels);
DecodedImage DecodePnm(const std::filesystem::path& file, std::int64_t max_pixels);

}  // namespace plumbline::internal
