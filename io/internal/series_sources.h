#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "io/internal/hdf5.h"

// Which files a series of virtual datasets takes its frames from: the group /sources.
namespace plumbline::internal {

struct SeriesSource {
  std::string name;  // relative to the folder of the file that names it
  std::int64_t size = 0;
  std::int64_t frames = 0;
  std::string sha256;  // of the whole file; empty: not known
};

// Throws hdf5::Error, as all here.
void WriteSources(hid_t file, const std::vector<SeriesSource>& sources);

// Empty where the file has none.
std::vector<SeriesSource> ReadSources(hid_t file);

// Sources that are missing or changed, one sentence each. HDF5 itself would give fill values for
// them without a word. hashes: not only the sizes are looked at.
std::vector<std::string> ProblemsOfSources(const std::filesystem::path& path,
                                           const std::vector<SeriesSource>& sources, bool hashes);

}  // namespace plumbline::internal
