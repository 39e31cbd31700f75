#pragma once

#include <cstdint>
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
  double time_s = 0;              // from the first frame; NaN where the recording has no clock
  std::string left_id, right_id;  // file name, or file name and frame number
  GrayImage left, right;
  std::string problem;  // empty, or one sentence naming file and fault; then the images are empty
};

struct ImageSourceOptions {
  std::optional<double> frames_per_second;  // for sources without a clock of their own
  // "a:b:c", as Python slices of positive step, or one number; empty: all. Negative ends count from
  // the declared end.
  std::string frames;
  // Of all images of a sequence, such as that of the reference; empty: that of the first good one.
  ImageSize expected_size;
  std::int64_t max_pixels = 200'000'000;  // an image larger than that is refused before decoding
  // A text table with one row a frame of the recording; its last column is the time, in the unit
  // that its heading ends in (ns, us, ms or s; without one: ns above 1e12, else s). Times are
  // delivered from the first row on. Empty: none.
  std::filesystem::path timestamps_csv;
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

  // Passes over the next pairs, without decoding them where that can be. Less than `count` where
  // the source ends.
  virtual void Skip(std::int64_t count) {
    while (count-- > 0 && Next()) {
    }
  }

  // What the user should know: colour turned into grey, 16-bit files that hold fewer, frames that a
  // video declares and does not hold. One sentence each; complete after the last Next().
  virtual std::vector<std::string> Notes() const = 0;

  // The files read, for the series' record of its inputs.
  virtual std::vector<std::filesystem::path> Files() const = 0;
};

// `left` and `right`: glob, folder, one image or one video each.
//
// Image files are sorted naturally (img2 before img10) and paired by the parts of their names that
// change from frame to frame; what is constant within a side (left, cam0, _1) does not count. Where
// no name has a partner (times, say) but the numbers agree, they are paired in order, and Notes()
// says so. All images of a source get the same number of bits or more as it goes on, so that both
// sides of a pair always have one scale.
// A video has no pairing to check but its counts: it ends with the shorter side.
//
// Throws InputError (nothing there, unequal numbers naming the files without partner, sides
// swapped, names that pair only in part), UsageError (a slice that is none).
std::unique_ptr<ImageSource> OpenImageSource(const std::string& left, const std::string& right,
                                             const ImageSourceOptions& options = {});

// The image files that a glob, a folder or a single path names, sorted naturally. Throws InputError
// when there are none.
std::vector<std::filesystem::path> ListImages(const std::string& pattern);

// One image file, 8 to 16 bit, mono or colour (turned into grey; *was_colour says so): PNG, TIFF,
// JPEG, BMP, binary PGM and PPM. Grey levels are never scaled; `bits` of a 16-bit file is what it
// states (PNG sBIT, TIFF MaxSampleValue, PGM maxval), else the smallest of 8, 10, 12, 14, 16 that
// holds its brightest pixel. Orientation tags are not applied. Throws InputError naming file and
// fault: truncated, damaged, too large, of no known format.
GrayImage ReadImage(const std::filesystem::path& file, bool* was_colour = nullptr,
                    std::int64_t max_pixels = 200'000'000);

}  // namespace plumbline
