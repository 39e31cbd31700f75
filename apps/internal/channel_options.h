#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/internal/option_table.h"
#include "io/series_writer.h"

namespace plumbline::internal {

// Signals that were logged beside the cameras.
class ChannelOptionSet {
 public:
  void Declare(OptionTable& options);
  // Empty where none were given. Throws UsageError, and as ReadChannelTable().
  std::vector<Channel> Read() const;
  // Where no table is given: those of a run, with what is said of their clock now.
  std::vector<Channel> ReadOr(std::vector<Channel> of_run) const;

  const std::string& file() const { return file_; }

 private:
  void SetClock(std::vector<Channel>* channels) const;

  std::string file_;
  std::optional<double> clock_offset_s_, sigma_clock_offset_s_;
};

}  // namespace plumbline::internal
