#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "io/image_sequence.h"
#include "io/internal/frame_selection.h"

namespace plumbline::internal {

struct DecodedImage;

// Image files of one camera, decoded one after the other.
class FileSequence : public ImageSequence {
 public:
  enum class Sizes { kMayDiffer, kMustAgree };

  // `noun`: what messages call the images ("images", "pairs").
  FileSequence(std::vector<std::filesystem::path> files, const ImageSourceOptions& options,
               Sizes sizes = Sizes::kMustAgree, std::string noun = "images");

  std::int64_t DeclaredCount() const override { return selection_.Count(); }
  std::optional<SequenceImage> Next() override;
  void Skip(std::int64_t count) { next_ += count * selection_.step; }
  std::vector<std::string> Notes() const override;
  std::vector<std::filesystem::path> Files() const override;

  // All of Notes() but the number of bits.
  std::vector<std::string> NotesOnFiles() const;

 private:
  std::string OtherSize(const SequenceImage& image);
  void Remember(const DecodedImage& decoded, const std::string& name);

  std::vector<std::filesystem::path> files_;
  ImageSourceOptions options_;
  Sizes sizes_;
  FrameSelection selection_;
  std::vector<double> times_;
  std::int64_t next_ = 0;
  int bits_ = 8;
  std::string first_id_;  // of the first good image, and its size
  ImageSize first_size_;
  std::vector<std::string> notes_;
  std::set<std::string> noted_;
  int colour_count_ = 0;
  std::string first_colour_;
};

// "the grey levels are taken as 12-bit"; nothing for 8 bits.
std::optional<std::string> NoteOnBits(int bits);

}  // namespace plumbline::internal
