#include "apps/internal/shard_option.h"

#include <fmt/format.h>

#include <charconv>

#include "calib/error.h"

namespace plumbline::internal {

SeriesShard ParseShard(const std::string& text) {
  SeriesShard shard;
  const char* const end = text.data() + text.size();
  const auto first = std::from_chars(text.data(), end, shard.index);
  bool good = first.ec == std::errc() && first.ptr != end && *first.ptr == '/';
  if (good) {
    const auto second = std::from_chars(first.ptr + 1, end, shard.count);
    good = second.ec == std::errc() && second.ptr == end;
  }
  if (!good || shard.index < 1 || shard.index > shard.count) {
    throw UsageError(fmt::format(
        "A shard is its number and how many there are, as 1/4 to 4/4, not '{}'.", text));
  }
  --shard.index;
  return shard;
}

SeriesShard CutOut(const SeriesShard& asked, std::int64_t frames, std::int64_t block_frames) {
  if (frames < 1) {
    throw InputError(
        "The recording does not say how many frames it holds, so that it cannot be cut into "
        "shards; give --frames with both ends.");
  }
  const SeriesShard shard = ShardOf(asked.index, asked.count, frames, block_frames);
  if (shard.first_frame >= EndOf(shard)) {
    throw InputError(fmt::format(
        "Shard {} of {} would hold no frame: the recording has {} frames in blocks of {}; take "
        "fewer shards or a smaller --block-frames.",
        asked.index + 1, asked.count, frames, block_frames));
  }
  return shard;
}

}  // namespace plumbline::internal
