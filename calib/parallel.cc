#include "calib/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace plumbline {
namespace {

constexpr std::size_t kGrain = 1024;

}  // namespace

void ForEachRange(std::size_t count, const std::function<void(std::size_t, std::size_t)>& body) {
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, count, kGrain),
      [&](const tbb::blocked_range<std::size_t>& range) { body(range.begin(), range.end()); });
}

}  // namespace plumbline
