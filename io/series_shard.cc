#include "io/series_shard.h"

#include <stdexcept>

namespace plumbline {

SeriesShard ShardOf(int index, int count, std::int64_t frame_count) {
  if (count < 1 || index < 0 || index >= count || frame_count < 0) {
    throw std::invalid_argument("ShardOf: there is no such shard");
  }
  const auto first = [&](std::int64_t i) {
    return i * (frame_count / count) + i * (frame_count % count) / count;
  };
  return {index, count, first(index), frame_count};
}

std::int64_t EndOf(const SeriesShard& shard) {
  if (shard.index + 1 == shard.count) return shard.frame_count;
  return ShardOf(shard.index + 1, shard.count, shard.frame_count).first_frame;
}

}  // namespace plumbline
