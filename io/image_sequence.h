#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "io/image_source.h"

namespace plumbline {

// One photograph of a camera, or the reason why there is none.
struct SequenceImage {
  std::int64_t index = 0;  // position in the recording, from 0
  double time_s = 0;       // from the first image; NaN where the recording has no clock
  std::string id;          // file name, or file name and frame number
  GrayImage image;
  std::string problem;  // empty, or one sentence naming file and fault; then the image is empty
};

// The images of one camera in order: what ImageSource is for two. One image at a time is held.
class ImageSequence {
 public:
  virtual ~ImageSequence() = default;

  // Images that Next() will deliver, if known beforehand (a video may hold fewer than it declares,
  // or declare none: then 0).
  virtual std::int64_t DeclaredCount() const = 0;

  // The next image, or nothing at the end. A damaged image, or one of another size than the first
  // good one, has a `problem` and is no exception.
  virtual std::optional<SequenceImage> Next() = 0;

  // What the user should know, one sentence each; complete after the last Next().
  virtual std::vector<std::string> Notes() const = 0;

  // The files read, for the record of the inputs.
  virtual std::vector<std::filesystem::path> Files() const = 0;
};

// `images`: glob, folder, one image or one video. Files are sorted naturally (img2 before img10),
// videos read through FFmpeg with 8 bits; options as for OpenImageSource(). All images get the same
// number of bits or more as the sequence goes on.
//
// Throws InputError (nothing there, a video that cannot be read, a damaged table of times),
// UsageError (a slice that is none, a frame rate that is not positive).
std::unique_ptr<ImageSequence> OpenImageSequence(const std::string& images,
                                                 const ImageSourceOptions& options = {});

// The same of several globs, folders and images, one after the other in the order given. Throws
// UsageError when there is none, or a video is not alone.
std::unique_ptr<ImageSequence> OpenImageSequence(const std::vector<std::string>& images,
                                                 const ImageSourceOptions& options = {});

}  // namespace plumbline
