#include "apps/internal/frame_options.h"

namespace plumbline::internal {

void FrameOptionSet::Declare(OptionTable& options, const std::string& what,
                             const std::string& one) {
  options.Add({.name = "frames",
               .help = "which " + what + ", as start:stop:step counted from 0; empty: all",
               .unit = "A:B:C"},
              &frames_);
  options.Add({.name = "fps",
               .help = "frames a second, for images without a clock of their own",
               .unit = "1/s",
               .min = 1e-6},
              &frames_per_second_);
  options.Add({.name = "timestamps",
               .help = "a text table with the time of each " + one + " in its last column",
               .unit = "FILE"},
              &timestamps_);
}

ImageSourceOptions FrameOptionSet::Options() const {
  ImageSourceOptions options;
  options.frames = frames_;
  options.frames_per_second = frames_per_second_;
  options.timestamps_csv = timestamps_;
  return options;
}

}  // namespace plumbline::internal
