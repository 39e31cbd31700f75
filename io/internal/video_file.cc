#include "io/internal/video_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/error.h"
#include "io/internal/image_decode.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

// FFmpeg and OpenCV print what they dislike straight to the terminal; we say it ourselves. The
// frame in which a file was cut off is not to be delivered: FFmpeg makes up what it lacks.
void SetUpDecoders() {
  static std::once_flag once;
  std::call_once(once, [] {
    setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
    setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "fflags;discardcorrupt", 0);
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

}  // namespace

VideoFile::VideoFile(fs::path file, std::int64_t max_pixels) : file_(std::move(file)) {
  SetUpDecoders();
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

std::string VideoFile::FrameName(std::int64_t index) const {
  return fmt::format("{}#{}", Name(), index);
}

double VideoFile::FramesPerSecond() const {
  const double rate = capture_.get(cv::CAP_PROP_FPS);
  return rate > 1e-3 && rate < 1e6 ? rate : 0;
}

bool VideoFile::SkipTo(std::int64_t index) {
  while (position_ < index && Skip()) {
  }
  return position_ >= index;
}

bool VideoFile::Skip() {
  if (at_end_ || !Grab()) return false;
  ++position_;
  return true;
}

std::optional<GrayImage> VideoFile::Read() {
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

void VideoFile::AddNotes(std::vector<std::string>* notes) const {
  const int bits = BitsOfPixelFormat(pixel_format_);
  if (bits > 8) {
    notes->push_back(
        fmt::format("{} holds {} bits a sample, of which the video decoder delivers "
                    "8; export it as TIFF or PNG images to keep all",
                    Name(), bits));
  }
  if (!IsGreyPixelFormat(pixel_format_)) {
    notes->push_back(
        fmt::format("{} is stored in colour; measured is its grey value (Rec. 601 luma)", Name()));
  }
  if (at_end_ && declared_ > 0 && position_ != declared_) {
    notes->push_back(fmt::format("{}: {} of the {} frames it declares could be read", Name(),
                                 position_, declared_));
  }
}

bool VideoFile::Grab() {
  try {
    if (capture_.grab()) return true;
  } catch (const cv::Exception&) {  // a damaged stream: it ends here
  }
  at_end_ = true;
  return false;
}

bool VideoFile::Retrieve(cv::Mat& image) {
  try {
    return capture_.retrieve(image) && !image.empty() && image.depth() == CV_8U &&
           (image.channels() == 1 || image.channels() == 3);
  } catch (const cv::Exception&) {
    return false;
  }
}

FrameSelection ParseVideoFrames(const std::string& text, std::int64_t declared) {
  if (text.empty()) return {};  // whatever is there
  if (declared > 0) return ParseFrames(text, declared);
  if (text.find('-') != std::string::npos) {
    throw UsageError("the video does not say how many frames it holds: count from the front");
  }
  return ParseFrames(text, FrameSelection().end);
}

std::int64_t DeclaredVideoFrames(FrameSelection selection, std::int64_t declared) {
  selection.end = std::min(selection.end, declared);
  return selection.Count();
}

}  // namespace plumbline::internal
