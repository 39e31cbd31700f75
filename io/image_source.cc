#include "io/image_source.h"

#include <fmt/format.h>

#include "calib/error.h"
#include "io/internal/file_list.h"
#include "io/internal/image_decode.h"
#include "io/internal/image_sources.h"

namespace plumbline {
namespace fs = std::filesystem;

void internal::CheckFrameRate(const ImageSourceOptions& options) {
  if (options.frames_per_second && !(*options.frames_per_second > 0)) {
    throw UsageError("the frame rate must be positive");
  }
}

std::unique_ptr<ImageSource> OpenImageSource(const std::string& left, const std::string& right,
                                             const ImageSourceOptions& options) {
  internal::CheckFrameRate(options);
  const std::vector<fs::path> left_files = internal::ListFiles(left, "left");
  const std::vector<fs::path> right_files = internal::ListFiles(right, "right");
  std::error_code ignored;
  if (fs::equivalent(left_files[0], right_files[0], ignored)) {
    throw InputError(fmt::format(
        "left and right are the same file {}: name one pattern or folder for each camera",
        left_files[0].string()));
  }
  const auto is_video = [](const std::vector<fs::path>& files) {
    return files.size() == 1 && internal::HasVideoExtension(files[0]);
  };
  if (is_video(left_files) != is_video(right_files)) {
    throw InputError(fmt::format("left is {} and right is {}: both must be videos or both images",
                                 is_video(left_files) ? "a video" : "images",
                                 is_video(right_files) ? "a video" : "images"));
  }
  if (is_video(left_files)) {
    return internal::OpenVideoPair(left_files[0], right_files[0], options);
  }
  return internal::OpenImagePairs(internal::PairByName(left_files, right_files), options);
}

std::vector<fs::path> ListImages(const std::string& pattern) {
  return internal::ListFiles(pattern, "");
}

GrayImage ReadImage(const fs::path& file, bool* was_colour, std::int64_t max_pixels) {
  internal::DecodedImage decoded = internal::DecodeImage(file, max_pixels);
  if (was_colour != nullptr) *was_colour = decoded.was_colour;
  return std::move(decoded.image);
}

}  // namespace plumbline
