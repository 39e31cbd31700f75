#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <mutex>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "calib/error.h"
#include "io/internal/frame_selection.h"
#include "io/internal/image_decode.h"
#include "io/internal/image_sources.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

// FFmpeg and OpenCV print what they dislike straight to the terminal; we say it ourselves.
void SilenceDecoders() {
  static std::once_flag once;
  std::call_once(once, [] {
    setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
    cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  });
}

// Bits a sample of an FFmpeg pixel format, from the code OpenCV gives for it: the last byte of the
// codes of deep formats is the depth (libavcodec/raw.c), that of the others a letter or digit.
int BitsOfPixelFormat(unsigned code) {
  const unsigned last = code >> 24;
  return last >= 9 && last <= 16 ? static_cast<int>(last) : 8;
}

bool IsGreyPixelFormat(unsigned code) {
  const std::string name = {static_cast<char>(code & 0xff), static_cast<char>(code >> 8 & 0xff)};
  return name == "Y8" || name == "GR" || name == "Y1";
}

// One video file, read from front to back.
class VideoFile {
 public:
  VideoFile(fs::path file, std::int64_t max_pixels) : file_(std::move(file)) {
    SilenceDecoders();
    OpenForReading(file_);  // says why, where it cannot be
    try {
      capture_.open(file_.string(), cv::CAP_FFMPEG);
    } catch (const cv::Exception&) {
      capture_.release();
    }
    if (!capture_.isOpened()) {
      throw InputError(
          fmt::format("{} is no video that FFmpeg can read, or it is damaged at its "
                      "beginning",
                      file_.string()));
    }
    CheckedSize(file_, static_cast<std::int64_t>(capture_.get(cv::CAP_PROP_FRAME_WIDTH)),
                static_cast<std::int64_t>(capture_.get(cv::CAP_PROP_FRAME_HEIGHT)), max_pixels);
    const double count = capture_.get(cv::CAP_PROP_FRAME_COUNT);
    declared_ = count > 0 && count < 1e12 ? static_cast<std::int64_t>(count) : 0;
    pixel_format_ = static_cast<unsigned>(capture_.get(cv::CAP_PROP_CODEC_PIXEL_FORMAT));
  }

  const fs::path& path() const { return file_; }
  std::string Name() const { return file_.filename().string(); }
  std::int64_t declared() const { return declared_; }
  std::int64_t position() const { return position_; }  // frames read or skipped so far
  bool at_end() const { return at_end_; }

  double FramesPerSecond() const {
    const double rate = capture_.get(cv::CAP_PROP_FPS);
    return rate > 1e-3 && rate < 1e6 ? rate : 0;
  }

  bool Skip() {
    if (at_end_ || !Grab()) return false;
    ++position_;
    return true;
  }

  // The next frame; nothing at the end.
  std::optional<GrayImage> Read() {
    if (!Skip()) return std::nullopt;
    cv::Mat colour, grey;
    if (!Retrieve(colour)) {
      --position_;
      at_end_ = true;
      return std::nullopt;
    }
    if (colour.channels() == 3) {
      cv::cvtColor(colour, grey, cv::COLOR_BGR2GRAY);
    } else {
      grey = colour;
    }
    GrayImage image;
    image.grey = Image<std::uint16_t>({grey.cols, grey.rows});
    for (int r = 0; r < grey.rows; ++r) {
      std::copy_n(grey.ptr<unsigned char>(r), grey.cols, image.grey.row(r));
    }
    return image;
  }

  void AddNotes(std::vector<std::string>* notes) const {
    const int bits = BitsOfPixelFormat(pixel_format_);
    if (bits > 8) {
      notes->push_back(
          fmt::format("{} holds {} bits a sample, of which the video decoder delivers "
                      "8; export it as TIFF or PNG images to keep all",
                      Name(), bits));
    }
    if (!IsGreyPixelFormat(pixel_format_)) {
      notes->push_back(fmt::format(
          "{} is stored in colour; measured is its grey value (Rec. 601 luma)", Name()));
    }
    if (at_end_ && declared_ > 0 && position_ != declared_) {
      notes->push_back(fmt::format("{}: {} of the {} frames it declares could be read", Name(),
                                   position_, declared_));
    }
  }

 private:
  bool Grab() {
    try {
      if (capture_.grab()) return true;
    } catch (const cv::Exception&) {  // a damaged stream: it ends here
    }
    at_end_ = true;
    return false;
  }

  bool Retrieve(cv::Mat& image) {
    try {
      return capture_.retrieve(image) && !image.empty() && image.depth() == CV_8U &&
             (image.channels() == 1 || image.channels() == 3);
    } catch (const cv::Exception&) {
      return false;
    }
  }

  fs::path file_;
  cv::VideoCapture capture_;
  std::int64_t declared_ = 0;
  std::int64_t position_ = 0;
  unsigned pixel_format_ = 0;
  bool at_end_ = false;
};

class VideoPair : public ImageSource {
 public:
  VideoPair(const fs::path& left, const fs::path& right, const ImageSourceOptions& options)
      : left_(left, options.max_pixels), right_(right, options.max_pixels) {
    declared_ = std::min(left_.declared(), right_.declared());
    // A video that declares no count may hold any number; only slices from the front work there.
    const bool counted = declared_ > 0;
    if (!counted && options.frames.find('-') != std::string::npos) {
      throw UsageError("these videos do not say how many frames they hold: count from the front");
    }
    selection_ = ParseFrames(options.frames, counted ? declared_ : FrameSelection().end);
    if (options.frames.empty()) selection_ = FrameSelection();  // whatever is there
    next_ = selection_.first;
    rate_ = options.frames_per_second.value_or(left_.FramesPerSecond());
    if (!options.timestamps_csv.empty()) times_ = ReadTimestamps(options.timestamps_csv);
  }

  std::int64_t DeclaredCount() const override {
    FrameSelection selection = selection_;
    selection.end = std::min(selection.end, declared_);
    return selection.Count();
  }

  std::optional<StereoFrame> Next() override {
    if (next_ >= selection_.end) return std::nullopt;
    const std::int64_t index = next_;
    while (left_.position() < index && left_.Skip() && right_.Skip()) {
    }
    if (left_.position() < index || right_.position() < index) return End();
    StereoFrame frame;
    std::optional<GrayImage> left = left_.Read();
    std::optional<GrayImage> right = right_.Read();
    if (!left || !right) return End();
    frame.index = index;
    frame.time_s = FrameTime(index, times_, rate_);
    frame.left_id = fmt::format("{}#{}", left_.Name(), index);
    frame.right_id = fmt::format("{}#{}", right_.Name(), index);
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
