#include "io/merge_series.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <set>
#include <string>

#include "calib/error.h"
#include "io/inspect.h"
#include "io/internal/durable_file.h"
#include "io/internal/hdf5_tree.h"
#include "io/internal/series_datasets.h"
#include "io/internal/series_join.h"
#include "io/series_shard.h"
#include "io/series_start.h"

namespace plumbline {
namespace fs = std::filesystem;
namespace hdf5 = internal::hdf5;
namespace {

struct Shard {
  fs::path file;
  SeriesShard part;
  std::vector<std::int64_t> index;  // of its frames
  std::string recipe;               // RecipeOfTheData()
};

struct Stopped {};

// Runs what reads a file; what is wrong in it becomes an InputError.
template <typename Read>
auto Reading(const fs::path& file, const Read& read) {
  try {
    return read();
  } catch (const hdf5::Error& error) {
    throw InputError(fmt::format("{} cannot be merged: {}", file.string(), error.what()));
  }
}

Shard ReadShard(const fs::path& file) {
  std::error_code failed;
  if (!fs::is_regular_file(file, failed)) {
    throw InputError(fmt::format("there is no shard {}", file.string()));
  }
  const std::vector<std::string> faults = Validate(file);
  if (!faults.empty()) {
    throw InputError(
        fmt::format("{} cannot be merged, it is not whole: {}{}", file.string(), faults[0],
                    faults.size() > 1 ? fmt::format(" (and {} more)", faults.size() - 1) : ""));
  }
  const hdf5::Id id = hdf5::OpenForeignFile(file);
  const auto part = internal::ReadShardAttributes(id.get());
  if (!part) {
    throw InputError(
        fmt::format("{} is no shard of a run: it was not measured with --shard", file.string()));
  }
  return {file, *part, hdf5::ReadArray<std::int64_t>(id.get(), "/frames/index"),
          RecipeOfTheData(hdf5::GetText(id.get(), "recipe"))};
}

void CheckSet(const std::vector<Shard>& shards) {  // in order
  const SeriesShard& first = shards[0].part;
  for (const Shard& shard : shards) {
    if (shard.part.count == first.count && shard.part.frame_count == first.frame_count &&
        shard.part.block_frames == first.block_frames)
      continue;
    throw InputError(
        fmt::format("{} is of a run of {} shards and {} frames, {} of one of {} and {}",
                    shards[0].file.string(), first.count, first.frame_count, shard.file.string(),
                    shard.part.count, shard.part.frame_count));
  }
  for (std::size_t i = 1; i < shards.size(); ++i) {
    if (shards[i].part.index != shards[i - 1].part.index) continue;
    throw InputError(fmt::format("{} and {} both are shard {} of {}", shards[i - 1].file.string(),
                                 shards[i].file.string(), shards[i].part.index + 1, first.count));
  }
  std::set<int> missing;
  for (int i = 0; i < first.count; ++i) missing.insert(missing.end(), i);
  for (const Shard& shard : shards) missing.erase(shard.part.index);
  if (missing.empty()) return;
  std::string names;
  for (const int i : missing) names += fmt::format("{}{}", names.empty() ? "" : ", ", i + 1);
  throw InputError(fmt::format("of the {} shards that {} is one of, these are missing: {}",
                               first.count, shards[0].file.string(), names));
}

void CheckFrames(const std::vector<Shard>& shards) {
  std::optional<std::int64_t> last;
  const Shard* before = nullptr;
  for (const Shard& shard : shards) {
    const auto held = static_cast<std::int64_t>(shard.index.size());
    const std::int64_t wanted = EndOf(shard.part) - shard.part.first_frame;
    if (held != wanted) {
      throw InputError(fmt::format(
          "{} holds {} frames, and {} are its part of the run: measure it to its end (--resume)",
          shard.file.string(), held, wanted));
    }
    for (const std::int64_t index : shard.index) {
      if (last && index <= *last) {
        throw InputError(fmt::format(
            "{} holds the frame {} behind the frame {}{}", shard.file.string(), index, *last,
            before == nullptr || before == &shard ? ""
                                                  : fmt::format(" of {}", before->file.string())));
      }
      last = index;
      before = &shard;
    }
  }
}

void CheckSameHeader(const Shard& first, const Shard& other) {
  const hdf5::Id a = hdf5::OpenForeignFile(first.file), b = hdf5::OpenForeignFile(other.file);
  const std::set<std::string> of_frames = internal::PathsOfFrames(a.get());
  auto difference = hdf5::FirstDifference(
      a.get(), b.get(), [&](const std::string& path, const std::string& attribute) {
        if (path == "/" && (attribute == "created" || attribute == "recipe")) return false;
        if (path == "/" && internal::IsOfShard(attribute)) return false;
        return attribute != "frame" && of_frames.count(path) == 0;  // that of each shard may differ
      });
  if (!difference && first.recipe != other.recipe) difference = "the recipe";
  if (!difference) return;
  throw InputError(fmt::format("{} and {} are not of the same run: they differ in {}",
                               first.file.string(), other.file.string(), *difference));
}

// Their names from the folder of the output.
std::vector<internal::SeriesSource> SourcesOf(const std::vector<Shard>& shards,
                                              const fs::path& folder, bool copy) {
  std::vector<internal::SeriesSource> sources;
  for (const Shard& shard : shards) {
    const fs::path name = fs::canonical(shard.file).lexically_relative(folder);
    const bool elsewhere = name.empty() || *name.begin() == "..";
    if (elsewhere && !copy) {
      throw InputError(fmt::format(
          "{} lies neither in {} nor below it, so that the merged file could not name it: put it "
          "there, or copy what it holds (--copy)",
          shard.file.string(), folder.string()));
    }
    sources.push_back({(elsewhere ? fs::canonical(shard.file) : name).string(),
                       static_cast<std::int64_t>(fs::file_size(shard.file)), 0,
                       copy ? "" : internal::Sha256(shard.file)});
  }
  return sources;
}

}  // namespace

MergedSeries MergeSeries(const std::vector<fs::path>& files, const fs::path& output,
                         const MergeOptions& options) {
  if (files.empty()) throw InputError("there are no shards to merge");
  const int steps = 2 * static_cast<int>(files.size());
  const auto proceed = [&](std::size_t step) {
    if (options.stop && options.stop()) throw Stopped{};
    if (options.progress) options.progress(static_cast<int>(step), steps);
  };
  try {
    std::vector<Shard> shards;
    for (const fs::path& file : files) {
      proceed(shards.size());
      shards.push_back(Reading(file, [&] { return ReadShard(file); }));
      std::error_code ignored;
      if (fs::equivalent(file, output, ignored)) {
        throw InputError(fmt::format("{} is a shard and the output too", file.string()));
      }
    }
    std::stable_sort(shards.begin(), shards.end(),
                     [](const Shard& a, const Shard& b) { return a.part.index < b.part.index; });
    CheckSet(shards);
    CheckFrames(shards);
    for (const Shard& shard : shards) {
      if (&shard == &shards[0]) continue;
      Reading(shard.file, [&] { CheckSameHeader(shards[0], shard); });
    }
    std::error_code failed;
    const fs::path folder =
        fs::canonical(output.parent_path().empty() ? fs::path(".") : output.parent_path(), failed);
    if (failed) internal::ThrowSystemError("cannot write", output, failed.value());
    const auto sources = SourcesOf(shards, folder, options.copy);
    MergedSeries merged{0, static_cast<int>(shards.size()), false};
    for (const Shard& shard : shards)
      merged.frames += static_cast<std::int64_t>(shard.index.size());
    internal::WriteDurably(folder / output.filename(), [&](const fs::path& temporary) {
      internal::JoinSeries(
          temporary, folder, sources,
          {.kind = options.copy ? internal::JoinKind::kCopy : internal::JoinKind::kVirtual,
           .proceed = [&](std::size_t source) { proceed(files.size() + source); },
           .finish = internal::RemoveShardAttributes});
    });
    if (options.progress) options.progress(steps, steps);
    return merged;
  } catch (const Stopped&) {
    return {0, 0, true};
  } catch (const hdf5::Error& error) {
    throw EnvironmentError(fmt::format("cannot write {}: {}", output.string(), error.what()));
  } catch (const fs::filesystem_error& error) {
    throw EnvironmentError(
        fmt::format("cannot write {}: {}", output.string(), error.code().message()));
  }
}

}  // namespace plumbline
