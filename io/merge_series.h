#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

namespace plumbline {

struct MergeOptions {
  // Copy all values into one plain file, instead of virtual datasets over the shards.
  bool copy = false;
  // Called before each file is read: checked first, then joined.
  std::function<void(int done, int count)> progress = {};
  // True: leave it; nothing is written then.
  std::function<bool()> stop = {};
};

struct MergedSeries {
  std::int64_t frames = 0;
  int shards = 0;
  bool stopped = false;
};

// Joins the shards of one run (SeriesHeader::shard), of either kind and in any order, into one
// series.
//
// Without `copy` the output holds virtual datasets over the shards, which have to stay where they
// are: in its folder or below it. Its /sources names them with sizes and SHA-256; readers refuse it
// when one is missing or has changed in size, Validate() also where one has changed. With `copy`
// its datasets hold, byte for byte, what those of a run without shards hold.
//
// Everything is checked before anything is written; the output appears when it is whole (temporary
// name, fsync, rename). Memory: that of the records of all frames, without points.
//
// Throws: InputError naming the files: one that is missing, no shard, or faulty by Validate();
//         shards that are missing or there twice, hold too few or too many frames, or have frames
//         out of order; headers, inputs, software or recipes (but for RecipeOfTheData()) that
//         differ; without `copy`, shards that lie elsewhere. EnvironmentError.
MergedSeries MergeSeries(const std::vector<std::filesystem::path>& shards,
                         const std::filesystem::path& output, const MergeOptions& options = {});

}  // namespace plumbline
