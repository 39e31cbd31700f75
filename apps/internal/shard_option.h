#pragma once

#include <cstdint>
#include <string>

#include "io/series_shard.h"

namespace plumbline::internal {

// "2/4": the second of four parts. Throws UsageError.
SeriesShard ParseShard(const std::string& text);

// The part of the recording that the shard is. Throws InputError where there is none.
SeriesShard CutOut(const SeriesShard& asked, std::int64_t frames, std::int64_t block_frames);

}  // namespace plumbline::internal
