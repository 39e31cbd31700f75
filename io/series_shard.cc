#include "io/series_shard.h"

#include <algorithm>
#include <stdexcept>

namespace plumbline {

SeriesShard ShardOf(int index, int count, std::int64_t frame_count, std::int64_t block_frames) {
  if (count < 1 || index < 0 || index >= count || frame_count < 0 || block_frames < 1) {
    throw std::invalid_argument("ShardOf: there is no such shard");
  }
  const std::int64_t blocks = frame_count / block_frames + (frame_count % block_frames != 0);
  const std::int64_t first_block = index * (blocks / count) + index * (blocks % count) / count;
  return {index, count, std::min(frame_count, first_block * block_frames), frame_count,
          block_frames};
}

std::int64_t EndOf(const SeriesShard& shard) {
  if (shard.index + 1 == shard.count) return shard.frame_count;
  return ShardOf(shard.index + 1, shard.count, shard.frame_count, shard.block_frames).first_frame;
}

}  // namespace plumbline
