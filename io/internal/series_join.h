#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "io/internal/hdf5.h"
#include "io/internal/series_sources.h"

// The frames of several series, of either kind, one after the other as one series.
namespace plumbline::internal {

enum class JoinKind : std::uint8_t {
  // Points are virtual datasets over the sources, named in /sources; all else is copied.
  kVirtual = 0,
  kCopy,  // points are copied chunk by chunk, as they are stored
};

struct JoinOptions {
  JoinKind kind = JoinKind::kVirtual;
  // Called before each source; what it throws goes on.
  std::function<void(std::size_t source)> proceed = {};
  // Called with the file at the end.
  std::function<void(hid_t file)> finish = {};
};

// Writes `file`. The sources lie at folder / name, hold real datasets, and have the same header:
// all of it is taken from the first one. SeriesSource::frames is filled in here. Throws
// hdf5::Error.
void JoinSeries(const std::filesystem::path& file, const std::filesystem::path& folder,
                std::vector<SeriesSource> sources, const JoinOptions& options);

// Paths of the datasets that have one row a frame, and of those that hold its contours.
std::set<std::string> PathsOfFrames(hid_t file);

}  // namespace plumbline::internal
