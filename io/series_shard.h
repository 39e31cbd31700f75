#pragma once

#include <cstdint>

namespace plumbline {

// A part of a run that was cut into `count` of them: what one worker of a cluster measures. Frames
// are counted along the whole run, from 0, whatever their SeriesFrame::index; a shard holds those
// from its first_frame up to that of the next one.
struct SeriesShard {
  int index = 0;  // 0 to count - 1
  int count = 1;
  std::int64_t first_frame = 0;
  std::int64_t frame_count = 0;   // of the whole run
  std::int64_t block_frames = 1;  // it is cut between blocks of so many frames only

  friend bool operator==(const SeriesShard&, const SeriesShard&) = default;
};

// Shard i of n of a run of so many frames: they differ by one block at most. Throws
// std::invalid_argument unless 0 <= index < count, frame_count >= 0 and block_frames >= 1.
SeriesShard ShardOf(int index, int count, std::int64_t frame_count, std::int64_t block_frames = 1);

// The first frame that is no more of it.
std::int64_t EndOf(const SeriesShard& shard);

}  // namespace plumbline
