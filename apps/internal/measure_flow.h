#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "apps/internal/measure_report.h"
#include "io/image_source.h"

namespace plumbline::internal {

// Which pairs of a recording are measured, by their place in it.
struct MeasuredRange {
  std::int64_t first = 0;         // that is read
  std::int64_t first_wanted = 0;  // those before are measured, but not delivered
  std::optional<std::int64_t> end;
};

// Reads, measures and delivers pairs, one after the other, the three at the same time: while one
// pair is measured the next one is decoded and the one before is written. At most three pairs are
// held, whatever the length of the recording. Stops where the source ends, where `stop` says so,
// and at what any of the three throws.
//
// Returns whether it was stopped.
bool RunFlow(ImageSource& source, const MeasuredRange& range,
             const std::function<ReportedFrame(const StereoFrame&, std::int64_t position)>& measure,
             const std::function<void(const ReportedFrame&)>& deliver,
             const std::function<bool()>& stop);

}  // namespace plumbline::internal
