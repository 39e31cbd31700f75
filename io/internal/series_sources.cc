#include "io/internal/series_sources.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>

#include "io/internal/durable_file.h"

namespace plumbline::internal {
namespace fs = std::filesystem;

void WriteSources(hid_t file, const std::vector<SeriesSource>& sources) {
  const hdf5::Id group = hdf5::CreateGroup(file, "/sources");
  hdf5::SetText(group.get(), "NX_class", "NXcollection");
  const hsize_t n = sources.size();
  std::vector<std::string> names, hashes;
  std::vector<std::int64_t> sizes, frames;
  for (const SeriesSource& source : sources) {
    names.push_back(source.name);
    hashes.push_back(source.sha256);
    sizes.push_back(source.size);
    frames.push_back(source.frames);
  }
  hdf5::MakeScale(
      hdf5::WriteTexts(
          file,
          {"/sources/name", "1", "file, from the folder of this one; its frames in order", {n}, {}},
          names),
      "source");
  const auto attach = [&](const hdf5::Id& dataset) {
    hdf5::AttachScales(file, dataset, {"/sources/name"});
  };
  attach(hdf5::WriteArray<std::int64_t>(
      file, {"/sources/size", "1", "size of the file in bytes", {n}, {}}, sizes));
  attach(hdf5::WriteArray<std::int64_t>(
      file, {"/sources/frames", "1", "frames that it holds", {n}, {}}, frames));
  attach(hdf5::WriteTexts(
      file, {"/sources/sha256", "1", "SHA-256 of the file; empty: not known", {n}, {}}, hashes));
}

std::vector<SeriesSource> ReadSources(hid_t file) {
  if (!hdf5::Exists(file, "/sources")) return {};
  constexpr hsize_t kMost = 1 << 20;
  const auto names = hdf5::ReadTexts(file, "/sources/name", kMost);
  const auto hashes = hdf5::ReadTexts(file, "/sources/sha256", kMost);
  const auto sizes = hdf5::ReadArray<std::int64_t>(file, "/sources/size", nullptr, kMost);
  const auto frames = hdf5::ReadArray<std::int64_t>(file, "/sources/frames", nullptr, kMost);
  if (hashes.size() != names.size() || sizes.size() != names.size() ||
      frames.size() != names.size()) {
    throw hdf5::Error("the columns of /sources differ in length");
  }
  std::vector<SeriesSource> sources;
  for (std::size_t i = 0; i < names.size(); ++i) {
    sources.push_back({names[i], sizes[i], frames[i], hashes[i]});
  }
  return sources;
}

std::vector<std::string> ProblemsOfSources(const fs::path& path,
                                           const std::vector<SeriesSource>& sources, bool hashes) {
  std::vector<std::string> problems(sources.size());
  tbb::parallel_for(std::size_t{0}, sources.size(), [&](std::size_t i) {
    const SeriesSource& source = sources[i];
    const fs::path file = path.parent_path() / source.name;
    std::error_code failed;
    const auto size = fs::file_size(file, failed);
    if (failed) {
      problems[i] = fmt::format("its source {} is missing", file.string());
    } else if (size != static_cast<std::uintmax_t>(source.size)) {
      problems[i] = fmt::format("its source {} has {} bytes and had {} when they were joined",
                                file.string(), size, source.size);
    } else if (hashes && !source.sha256.empty() && Sha256(file) != source.sha256) {
      problems[i] = fmt::format("its source {} has changed since they were joined", file.string());
    }
  });
  std::erase(problems, "");
  return problems;
}

}  // namespace plumbline::internal
