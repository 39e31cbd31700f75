#include "io/internal/live_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <future>
#include <vector>

#include "io/internal/durable_file.h"
#include "io/internal/hdf5.h"
#include "io/internal/series_join.h"
#include "io/internal/series_pack.h"
#include "io/internal/series_parts.h"

namespace plumbline::internal {
namespace fs = std::filesystem;
namespace {

using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point then) {
  return std::chrono::duration<double>(Clock::now() - then).count();
}

// Segments become longer as the run does, so that live.h5, which names all of them, stays small and
// its writing cheap: a run of ten hours has some 250.
constexpr double kLeastShareOfRun = 0.02;

}  // namespace

struct LiveView::Impl {
  fs::path series;
  SeriesShape shape;
  LiveReading options;
  JournalPlace written;  // where the next segment begins
  std::vector<SeriesSource> segments;
  Clock::time_point begun = Clock::now(), last = begun;
  double last_took_s = 0;
  std::string problem;
  std::future<std::string> task;  // gives the problem

  bool IsDue() const {
    return SecondsSince(last) >= std::max({options.every_s, kLeastShareOfRun * SecondsSince(begun),
                                           last_took_s / options.largest_load});
  }

  void Write(JournalPlace end) {
    const auto frames = static_cast<std::int64_t>(end.index - written.index);
    SeriesSource segment{fmt::format("segment-{:06}.h5", segments.size()), 0, frames, ""};
    const fs::path file = PartsFolder(series) / segment.name;
    WriteDurably(file, [&](const fs::path& temporary) {
      JournalReader journal(JournalFile(series), written);
      PackRecords(temporary, HeaderFile(series), journal, shape, frames, "[]");
    });
    segment.size = static_cast<std::int64_t>(fs::file_size(file));
    segments.push_back(segment);
    written = end;
    WriteDurably(LiveFile(series), [&](const fs::path& temporary) {
      JoinSeries(temporary, PartsFolder(series), segments,
                 {.finish = [&](hid_t file_id) { hdf5::SetInteger(file_id, kGoesOn, 1); }});
    });
  }

  // Takes over the end of the last task.
  void Collect() {
    if (task.valid()) problem = task.get();
  }
};

LiveView::LiveView(const fs::path& series, const SeriesShape& shape, JournalPlace begin,
                   const LiveReading& options)
    : impl_(new Impl{.series = series,
                     .shape = shape,
                     .options = options,
                     .written = begin,
                     .segments = {},
                     .problem = {},
                     .task = {}}) {
  RemoveLiveFiles(series);
}

LiveView::~LiveView() { impl_->Collect(); }

void LiveView::Committed(JournalPlace end) {
  if (!(impl_->options.every_s > 0)) return;
  if (impl_->task.valid() &&
      impl_->task.wait_for(std::chrono::seconds(0)) != std::future_status::ready) {
    return;
  }
  impl_->Collect();
  if (!impl_->problem.empty() || !impl_->IsDue()) return;
  impl_->last = Clock::now();
  impl_->task = std::async(std::launch::async, [impl = impl_.get(), end]() -> std::string {
    const auto start = Clock::now();
    try {
      impl->Write(end);
    } catch (const std::exception& error) {
      return error.what();
    }
    impl->last_took_s = SecondsSince(start);
    return "";
  });
}

std::string LiveView::problem() const { return impl_->problem; }

}  // namespace plumbline::internal
