#pragma once

#include <string>
#include <vector>

#include "apps/progress.h"
#include "calib/board.h"
#include "calib/calibrate.h"
#include "io/image_source.h"

namespace plumbline {

// Calibration photographs turned into points.
struct DetectedPairs {
  ImageSize left_size, right_size;
  std::vector<CalibrationPair> pairs;  // one a pair of photographs; with a problem where unusable
  std::vector<std::string> notes;      // what the image source has to say
  bool interrupted = false;            // Ctrl-C: the rest was not looked at
};

// Reads all pairs in order and finds the board in them, several at a time. A photograph that cannot
// be read, or has another size than the first of its side, becomes a detection with a problem. The
// result does not depend on the number of threads. Throws InputError when no photograph can be
// read.
DetectedPairs DetectPairs(const BoardSpec& board, ImageSource& source, ProgressStyle style);

}  // namespace plumbline
