#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "io/internal/frame_selection.h"
#include "io/internal/image_sources.h"
#include "io/internal/video_file.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

class VideoPair : public ImageSource {
 public:
  VideoPair(const fs::path& left, const fs::path& right, const ImageSourceOptions& options)
      : left_(left, options.max_pixels), right_(right, options.max_pixels) {
    declared_ = std::min(left_.declared(), right_.declared());
    selection_ = ParseVideoFrames(options.frames, declared_);
    next_ = selection_.first;
    rate_ = options.frames_per_second.value_or(left_.FramesPerSecond());
    if (!options.timestamps_csv.empty()) times_ = ReadTimestamps(options.timestamps_csv);
  }

  std::int64_t DeclaredCount() const override { return DeclaredVideoFrames(selection_, declared_); }

  std::optional<StereoFrame> Next() override {
    if (next_ >= selection_.end) return std::nullopt;
    const std::int64_t index = next_;
    if (!left_.SkipTo(index) || !right_.SkipTo(index)) return End();
    StereoFrame frame;
    std::optional<GrayImage> left = left_.Read();
    std::optional<GrayImage> right = right_.Read();
    if (!left || !right) return End();
    frame.index = index;
    frame.time_s = FrameTime(index, times_, rate_);
    frame.left_id = left_.FrameName(index);
    frame.right_id = right_.FrameName(index);
    frame.left = std::move(*left);
    frame.right = std::move(*right);
    next_ = index + selection_.step;
    return frame;
  }

  std::vector<std::string> Notes() const override {
    std::vector<std::string> notes;
    left_.AddNotes(&notes);
    right_.AddNotes(&notes);
    if (left_.declared() != right_.declared()) {
      notes.push_back(fmt::format("{} declares {} frames and {} {}: measured up to the shorter",
                                  left_.Name(), left_.declared(), right_.Name(),
                                  right_.declared()));
    } else if (left_.at_end() != right_.at_end() && left_.position() != right_.position()) {
      const VideoFile& shorter = left_.at_end() ? left_ : right_;
      const VideoFile& longer = left_.at_end() ? right_ : left_;
      notes.push_back(
          fmt::format("{} goes on after the last frame of {}: measured up to the "
                      "shorter",
                      longer.Name(), shorter.Name()));
    }
    return notes;
  }

  std::vector<fs::path> Files() const override { return {left_.path(), right_.path()}; }

 private:
  std::optional<StereoFrame> End() {
    next_ = std::numeric_limits<std::int64_t>::max();
    return std::nullopt;
  }

  VideoFile left_, right_;
  FrameSelection selection_;
  std::vector<double> times_;
  std::int64_t declared_ = 0;
  std::int64_t next_ = 0;
  double rate_ = 0;
};

}  // namespace

std::unique_ptr<ImageSource> OpenVideoPair(const fs::path& left, const fs::path& right,
                                           const ImageSourceOptions& options) {
  return std::make_unique<VideoPair>(left, right, options);
}

}  // namespace plumbline::internal
