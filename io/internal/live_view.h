#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "io/internal/journal.h"
#include "io/internal/point_layout.h"
#include "io/series_start.h"

namespace plumbline::internal {

// What readers can follow while a run goes on: in the parts folder, segments that are whole series
// with the frames since the one before, and live.h5, all of them as one. Each is written by a
// thread of its own to a temporary name and renamed; compressed chunks are copied from the journal.
// The run does not depend on any of it: what goes wrong here ends the view and not the run.
class LiveView {
 public:
  // begin: of the first frame in the journal. Removes what an earlier process left.
  LiveView(const std::filesystem::path& series, const SeriesShape& shape, JournalPlace begin,
           const LiveReading& options);
  ~LiveView();  // waits for what is being written
  LiveView(const LiveView&) = delete;
  LiveView& operator=(const LiveView&) = delete;

  // After each frame. end: that of the journal.
  void Committed(JournalPlace end);

  // Why there is no view any more; empty: there is one.
  std::string problem() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline::internal
