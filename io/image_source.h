#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// One synchronised pair, or the reason why there is none.
struct StereoFrame {
  std::int64_t index = 0;         // position in the recording, from 0
  double time_s = 0;              // NaN where the recording has no clock
  std::string left_id, right_id;  // file name, or file name and frame number
  GrayImage left, right;
  std::string problem;  // empty, or one sentence naming file and fault; then the images are empty
};

struct ImageSourceOptions {
  std::optional<double> frames_per_second;  // for sources without a clock of their own
  std::string frames;                       // "a:b:c", as Python slices; empty: all
  std::int64_t max_pixels = 200'000'000;    // refused before decoding
};

// Where pairs of images come from: a glob, a folder, a video, (later) a recording, live cameras,
// the virtual rig.
class ImageSource {
 public:
  virtual ~ImageSource() = default;

  // Pairs that Next() will deliver, if known beforehand (a video may hold fewer than it declares).
  virtual std::int64_t DeclaredCount() const = 0;

  // The next pair, or nothing at the end. A damaged image is a frame with a `problem`, not an
  // exception.
  virtual std::optional<StereoFrame> Next() = 0;

  // What the user should know beforehand: colour turned into grey, unequal counts, unpaired files.
  // One sentence each.
  virtual std::vector<std::string> Notes() const = 0;

  // The files read, for the series' record of its inputs.
  virtual std::vector<std::filesystem::path> Files() const = 0;
};

// `left` and `right`: glob, folder or video. Throws InputError (nothing there, unequal numbers,
// names that do not pair).
std::unique_ptr<ImageSource> OpenImageSource(const std::string& left, const std::string& right,
                                             const ImageSourceOptions& options = {});

// One image file, 8 to 16 bit, mono or colour (turned into grey; *was_colour says so). Throws
// InputError naming file and fault: truncated, damaged, too large, of no known format.
GrayImage ReadImage(const std::filesystem::path& file, bool* was_colour = nullptr,
                    std::int64_t max_pixels = 200'000'000);

}  // namespace plumbline
