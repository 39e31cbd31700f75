#include "apps/internal/measure_flow.h"

#include <oneapi/tbb/parallel_pipeline.h>
#include <oneapi/tbb/task_arena.h>

#include <memory>

namespace plumbline::internal {
namespace {

struct Read {
  StereoFrame pair;
  std::int64_t position;
};
using ReadPtr = std::shared_ptr<Read>;
using MeasuredPtr = std::shared_ptr<ReportedFrame>;  // null: not to be delivered

constexpr std::size_t kPairsHeld = 3;

}  // namespace

bool RunFlow(ImageSource& source, const MeasuredRange& range,
             const std::function<ReportedFrame(const StereoFrame&, std::int64_t position)>& measure,
             const std::function<void(const ReportedFrame&)>& deliver,
             const std::function<bool()>& stop) {
  source.Skip(range.first);
  std::int64_t next = range.first;
  bool stopped = false;
  const auto read = [&](tbb::flow_control& control) -> ReadPtr {
    stopped = stopped || stop();
    if (!stopped && !(range.end && next >= *range.end)) {
      if (std::optional<StereoFrame> pair = source.Next()) {
        return std::make_shared<Read>(Read{std::move(*pair), next++});
      }
    }
    control.stop();
    return nullptr;
  };
  const auto evaluate = [&](const ReadPtr& read_pair) -> MeasuredPtr {
    MeasuredPtr measured;
    // Threads that wait in here must not take up the decoding of the next pair.
    tbb::this_task_arena::isolate([&] {
      measured = std::make_shared<ReportedFrame>(measure(read_pair->pair, read_pair->position));
    });
    return read_pair->position < range.first_wanted ? nullptr : measured;
  };
  const auto write = [&](const MeasuredPtr& measured) {
    if (measured) tbb::this_task_arena::isolate([&] { deliver(*measured); });
  };
  tbb::parallel_pipeline(
      kPairsHeld,
      tbb::make_filter<void, ReadPtr>(tbb::filter_mode::serial_in_order, read) &
          tbb::make_filter<ReadPtr, MeasuredPtr>(tbb::filter_mode::serial_in_order, evaluate) &
          tbb::make_filter<MeasuredPtr, void>(tbb::filter_mode::serial_in_order, write));
  return stopped;
}

}  // namespace plumbline::internal
