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

  const std::string& file() const { return file_; }

 private:
  std::string file_;
  std::optional<double> clock_offset_s_, sigma_clock_offset_s_;
};

}  // namespace plumbline::internal
