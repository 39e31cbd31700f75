#pragma once

#include <cstdint>
#include <filesystem>
#include <opencv2/videoio.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "io/internal/frame_selection.h"

namespace plumbline::internal {

// One video file, read from front to back through FFmpeg, as 8-bit grey.
class VideoFile {
 public:
  // Throws InputError when it cannot be read, or its images are larger than max_pixels.
  VideoFile(std::filesystem::path file, std::int64_t max_pixels);

  const std::filesystem::path& path() const { return file_; }
  std::string Name() const { return file_.filename().string(); }
  std::string FrameName(std::int64_t index) const;     // "left.avi#12"
  std::int64_t declared() const { return declared_; }  // 0: it does not say
  std::int64_t position() const { return position_; }  // frames read or skipped so far
  bool at_end() const { return at_end_; }
  double FramesPerSecond() const;  // 0: it does not say

  // Goes on to the frame `index`; false where the video ends before it.
  bool SkipTo(std::int64_t index);

  // The next frame; nothing at the end.
  std::optional<GrayImage> Read();

  // What the user should know of the file; complete at its end.
  void AddNotes(std::vector<std::string>* notes) const;

 private:
  bool Skip();
  bool Grab();
  bool Retrieve(cv::Mat& image);

  std::filesystem::path file_;
  cv::VideoCapture capture_;
  std::int64_t declared_ = 0;
  std::int64_t position_ = 0;
  unsigned pixel_format_ = 0;
  bool at_end_ = false;
};

// The frames of a video that declares so many (0: any number, of which only slices from the front
// can be taken). Throws UsageError.
FrameSelection ParseVideoFrames(const std::string& text, std::int64_t declared);

// How many of the declared ones are selected.
std::int64_t DeclaredVideoFrames(FrameSelection selection, std::int64_t declared);

}  // namespace plumbline::internal
