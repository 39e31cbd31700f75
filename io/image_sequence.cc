#include "io/image_sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "calib/error.h"
#include "io/internal/file_list.h"
#include "io/internal/file_sequence.h"
#include "io/internal/frame_selection.h"
#include "io/internal/image_sources.h"
#include "io/internal/video_file.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace {

class VideoSequence : public ImageSequence {
 public:
  VideoSequence(const fs::path& file, const ImageSourceOptions& options)
      : video_(file, options.max_pixels),
        selection_(internal::ParseVideoFrames(options.frames, video_.declared())),
        next_(selection_.first),
        rate_(options.frames_per_second.value_or(video_.FramesPerSecond())) {
    if (!options.timestamps_csv.empty()) times_ = internal::ReadTimestamps(options.timestamps_csv);
  }

  std::int64_t DeclaredCount() const override {
    return internal::DeclaredVideoFrames(selection_, video_.declared());
  }

  std::optional<SequenceImage> Next() override {
    if (next_ >= selection_.end || !video_.SkipTo(next_)) return End();
    std::optional<GrayImage> image = video_.Read();
    if (!image) return End();
    SequenceImage out;
    out.index = next_;
    out.time_s = internal::FrameTime(out.index, times_, rate_);
    out.id = video_.FrameName(out.index);
    out.image = std::move(*image);
    next_ += selection_.step;
    return out;
  }

  std::vector<std::string> Notes() const override {
    std::vector<std::string> notes;
    video_.AddNotes(&notes);
    return notes;
  }

  std::vector<fs::path> Files() const override { return {video_.path()}; }

 private:
  std::optional<SequenceImage> End() {
    next_ = std::numeric_limits<std::int64_t>::max();
    return std::nullopt;
  }

  internal::VideoFile video_;
  internal::FrameSelection selection_;
  std::vector<double> times_;
  std::int64_t next_ = 0;
  double rate_ = 0;
};

}  // namespace

std::unique_ptr<ImageSequence> OpenImageSequence(const std::string& images,
                                                 const ImageSourceOptions& options) {
  return OpenImageSequence(std::vector<std::string>{images}, options);
}

std::unique_ptr<ImageSequence> OpenImageSequence(const std::vector<std::string>& images,
                                                 const ImageSourceOptions& options) {
  internal::CheckFrameRate(options);
  if (images.empty()) throw UsageError("no images are named: give a glob, a folder or a video");
  std::vector<fs::path> files;
  for (const std::string& pattern : images) {
    const std::vector<fs::path> found = internal::ListFiles(pattern, "");
    files.insert(files.end(), found.begin(), found.end());
  }
  const auto video = std::find_if(files.begin(), files.end(), internal::HasVideoExtension);
  if (video == files.end()) {
    return std::make_unique<internal::FileSequence>(std::move(files), options);
  }
  if (files.size() > 1) {
    throw UsageError(fmt::format("{} is a video: name it alone, without {} other files",
                                 video->string(), files.size() - 1));
  }
  return std::make_unique<VideoSequence>(files[0], options);
}

}  // namespace plumbline
