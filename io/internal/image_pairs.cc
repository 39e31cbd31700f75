#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <limits>

#include "io/internal/file_sequence.h"
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

ImageSourceOptions WithoutTimes(ImageSourceOptions options) {
  options.timestamps_csv.clear();
  return options;
}

class ImagePairs : public ImageSource {
 public:
  ImagePairs(PairedFiles pairs, const ImageSourceOptions& options)
      : pairing_note_(std::move(pairs.note)),
        left_(std::move(pairs.left), options, FileSequence::Sizes::kMayDiffer, "pairs"),
        right_(std::move(pairs.right), WithoutTimes(options), FileSequence::Sizes::kMayDiffer) {}

  std::int64_t DeclaredCount() const override { return left_.DeclaredCount(); }

  std::optional<StereoFrame> Next() override {
    std::optional<SequenceImage> left, right;
    tbb::parallel_invoke([&] { left = left_.Next(); }, [&] { right = right_.Next(); });
    if (!left || !right) return std::nullopt;
    StereoFrame frame;
    frame.index = left->index;
    frame.time_s = left->time_s;
    frame.left_id = left->id;
    frame.right_id = right->id;
    frame.problem = left->problem;
    if (!right->problem.empty()) {
      frame.problem += (left->problem.empty() ? "" : "; ") + right->problem;
    }
    if (!frame.problem.empty()) return frame;
    bits_ = std::max({bits_, left->image.bits, right->image.bits});
    frame.left = std::move(left->image);
    frame.right = std::move(right->image);
    frame.left.bits = frame.right.bits = bits_;
    return frame;
  }

  void Skip(std::int64_t count) override {
    left_.Skip(count);
    right_.Skip(count);
  }

  std::vector<std::string> Notes() const override {
    std::vector<std::string> notes;
    if (!pairing_note_.empty()) notes.push_back(pairing_note_);
    for (const FileSequence* side : {&left_, &right_}) {
      const std::vector<std::string> own = side->NotesOnFiles();
      notes.insert(notes.end(), own.begin(), own.end());
    }
    if (const auto note = NoteOnBits(bits_)) notes.push_back(*note);
    return notes;
  }

  std::vector<fs::path> Files() const override {
    const std::vector<fs::path> left = left_.Files();
    const std::vector<fs::path> right = right_.Files();
    std::vector<fs::path> files;
    for (std::size_t i = 0; i < left.size(); ++i) {
      files.push_back(left[i]);
      files.push_back(right[i]);
    }
    return files;
  }

 private:
  std::string pairing_note_;
  FileSequence left_, right_;
  int bits_ = 8;
};

}  // namespace

std::unique_ptr<ImageSource> OpenImagePairs(PairedFiles pairs, const ImageSourceOptions& options) {
  return std::make_unique<ImagePairs>(std::move(pairs), options);
}

}  // namespace plumbline::internal
