#include <fmt/format.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "calib/error.h"
#include "io/internal/frame_selection.h"
#include "io/internal/image_decode.h"
#include "io/internal/image_sources.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

double FrameTime(std::int64_t index, const std::vector<double>& table, double frames_per_second) {
  if (!table.empty()) {
    return static_cast<std::size_t>(index) < table.size()
               ? table[static_cast<std::size_t>(index)]
               : std::numeric_limits<double>::quiet_NaN();
  }
  if (frames_per_second > 0) return static_cast<double>(index) / frames_per_second;
  return std::numeric_limits<double>::quiet_NaN();
}

namespace {

struct DecodedOrProblem {
  DecodedImage decoded;
  std::string problem;
};

DecodedOrProblem TryDecode(const fs::path& file, std::int64_t max_pixels) {
  DecodedOrProblem result;
  try {
    result.decoded = DecodeImage(file, max_pixels);
  } catch (const InputError& error) {
    result.problem = error.what();
  }
  return result;
}

class ImagePairs : public ImageSource {
 public:
  ImagePairs(PairedFiles pairs, const ImageSourceOptions& options)
      : pairs_(std::move(pairs)), options_(options) {
    if (!pairs_.note.empty()) notes_.push_back(pairs_.note);
    const auto count = static_cast<std::int64_t>(pairs_.left.size());
    selection_ = ParseFrames(options.frames, count);
    next_ = selection_.first;
    if (!options.timestamps_csv.empty()) {
      times_ = ReadTimestamps(options.timestamps_csv);
      if (static_cast<std::int64_t>(times_.size()) != count) {
        notes_.push_back(fmt::format("{} holds {} times for {} pairs",
                                     options.timestamps_csv.string(), times_.size(), count));
      }
    }
  }

  std::int64_t DeclaredCount() const override { return selection_.Count(); }

  std::optional<StereoFrame> Next() override {
    if (next_ >= selection_.end) return std::nullopt;
    const auto i = static_cast<std::size_t>(next_);
    StereoFrame frame;
    frame.index = next_;
    next_ += selection_.step;
    frame.time_s = FrameTime(frame.index, times_, options_.frames_per_second.value_or(0));
    frame.left_id = pairs_.left[i].filename().string();
    frame.right_id = pairs_.right[i].filename().string();
    DecodedOrProblem left, right;
    tbb::parallel_invoke([&] { left = TryDecode(pairs_.left[i], options_.max_pixels); },
                         [&] { right = TryDecode(pairs_.right[i], options_.max_pixels); });
    frame.problem = left.problem;
    if (!right.problem.empty()) frame.problem += (left.problem.empty() ? "" : "; ") + right.problem;
    if (!frame.problem.empty()) return frame;
    Remember(left.decoded, frame.left_id, colour_left_);
    Remember(right.decoded, frame.right_id, colour_right_);
    bits_ = std::max({bits_, left.decoded.image.bits, right.decoded.image.bits});
    frame.left = std::move(left.decoded.image);
    frame.right = std::move(right.decoded.image);
    frame.left.bits = frame.right.bits = bits_;
    return frame;
  }

  std::vector<std::string> Notes() const override {
    std::vector<std::string> notes = notes_;
    for (const Colour& colour : {colour_left_, colour_right_}) {
      if (colour.count > 0) {
        notes.push_back(
            fmt::format("{} of the images read so far, {} first, {} in colour; "
                        "measured is their grey value (Rec. 601 luma)",
                        colour.count, colour.first, colour.count == 1 ? "is" : "are"));
      }
    }
    if (bits_ > 8) notes.push_back(fmt::format("the grey levels are taken as {}-bit", bits_));
    return notes;
  }

  std::vector<fs::path> Files() const override {
    std::vector<fs::path> files;
    for (std::int64_t i = selection_.first; i < selection_.end; i += selection_.step) {
      files.push_back(pairs_.left[static_cast<std::size_t>(i)]);
      files.push_back(pairs_.right[static_cast<std::size_t>(i)]);
    }
    return files;
  }

 private:
  struct Colour {
    int count = 0;
    std::string first;
  };

  void Remember(const DecodedImage& decoded, const std::string& name, Colour& colour) {
    if (decoded.was_colour && colour.count++ == 0) colour.first = name;
    if (!decoded.note.empty() && noted_.insert(decoded.note).second) {
      notes_.push_back(name + ": " + decoded.note);
    }
  }

  PairedFiles pairs_;
  ImageSourceOptions options_;
  FrameSelection selection_;
  std::vector<double> times_;
  std::int64_t next_ = 0;
  int bits_ = 8;
  std::vector<std::string> notes_;
  std::set<std::string> noted_;
  Colour colour_left_, colour_right_;
};

}  // namespace

std::unique_ptr<ImageSource> OpenImagePairs(PairedFiles pairs, const ImageSourceOptions& options) {
  return std::make_unique<ImagePairs>(std::move(pairs), options);
}

}  // namespace plumbline::internal
