#include "io/internal/file_sequence.h"

#include <fmt/format.h>

#include <algorithm>

#include "calib/error.h"
#include "io/internal/image_decode.h"
#include "io/internal/image_sources.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

FileSequence::FileSequence(std::vector<fs::path> files, const ImageSourceOptions& options,
                           Sizes sizes, std::string noun)
    : files_(std::move(files)), options_(options), sizes_(sizes) {
  const auto count = static_cast<std::int64_t>(files_.size());
  selection_ = ParseFrames(options.frames, count);
  next_ = selection_.first;
  if (options.expected_size != ImageSize{}) {
    first_id_ = "the reference";
    first_size_ = options.expected_size;
  }
  if (options.timestamps_csv.empty()) return;
  times_ = ReadTimestamps(options.timestamps_csv);
  if (static_cast<std::int64_t>(times_.size()) != count) {
    notes_.push_back(fmt::format("{} holds {} times for {} {}", options.timestamps_csv.string(),
                                 times_.size(), count, noun));
  }
}

std::optional<SequenceImage> FileSequence::Next() {
  if (next_ >= selection_.end) return std::nullopt;
  const fs::path& file = files_[static_cast<std::size_t>(next_)];
  SequenceImage out;
  out.index = next_;
  next_ += selection_.step;
  out.time_s = FrameTime(out.index, times_, options_.frames_per_second.value_or(0));
  out.id = file.filename().string();
  DecodedImage decoded;
  try {
    decoded = DecodeImage(file, options_.max_pixels);
  } catch (const InputError& error) {
    out.problem = error.what();
    return out;
  }
  Remember(decoded, out.id);
  out.image = std::move(decoded.image);
  if (sizes_ == Sizes::kMustAgree) out.problem = OtherSize(out);
  if (!out.problem.empty()) {
    out.image = {};
    return out;
  }
  bits_ = std::max(bits_, out.image.bits);
  out.image.bits = bits_;
  return out;
}

std::vector<std::string> FileSequence::NotesOnFiles() const {
  std::vector<std::string> notes = notes_;
  if (colour_count_ > 0) {
    notes.push_back(
        fmt::format("{} of the images read so far, {} first, {} in colour; "
                    "measured is their grey value (Rec. 601 luma)",
                    colour_count_, first_colour_, colour_count_ == 1 ? "is" : "are"));
  }
  return notes;
}

std::vector<std::string> FileSequence::Notes() const {
  std::vector<std::string> notes = NotesOnFiles();
  if (const auto note = NoteOnBits(bits_)) notes.push_back(*note);
  return notes;
}

std::vector<fs::path> FileSequence::Files() const {
  std::vector<fs::path> files;
  for (std::int64_t i = selection_.first; i < selection_.end; i += selection_.step) {
    files.push_back(files_[static_cast<std::size_t>(i)]);
  }
  return files;
}

std::string FileSequence::OtherSize(const SequenceImage& image) {
  const ImageSize size = image.image.size();
  if (first_id_.empty()) {
    first_id_ = image.id;
    first_size_ = size;
  }
  if (size == first_size_) return "";
  return fmt::format("{} is {}x{} px and {} is {}x{} px: images of one camera have one size",
                     image.id, size.width, size.height, first_id_, first_size_.width,
                     first_size_.height);
}

void FileSequence::Remember(const DecodedImage& decoded, const std::string& name) {
  if (decoded.was_colour && colour_count_++ == 0) first_colour_ = name;
  if (!decoded.note.empty() && noted_.insert(decoded.note).second) {
    notes_.push_back(name + ": " + decoded.note);
  }
}

std::optional<std::string> NoteOnBits(int bits) {
  if (bits <= 8) return std::nullopt;
  return fmt::format("the grey levels are taken as {}-bit", bits);
}

}  // namespace plumbline::internal
