#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

namespace plumbline::internal {

// A Python slice of frames, with both ends known.
struct FrameSelection {
  std::int64_t first = 0;
  std::int64_t end = std::numeric_limits<std::int64_t>::max();  // not included
  std::int64_t step = 1;

  std::int64_t Count() const { return end > first ? (end - first + step - 1) / step : 0; }
};

// Reads "a:b:c", "a:b", "a" (that frame alone) or "" (all) for a recording of `count` frames.
// Throws UsageError when it is none of these, or the step is not positive.
FrameSelection ParseFrames(const std::string& text, std::int64_t count);

// The times of a table as ImageSourceOptions::timestamps_csv describes it, in seconds from its
// first row. Throws InputError naming file and line.
std::vector<double> ReadTimestamps(const std::filesystem::path& file);

}  // namespace plumbline::internal
