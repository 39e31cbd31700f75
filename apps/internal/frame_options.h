#pragma once

#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "io/image_source.h"

namespace plumbline::internal {

// Which images of a recording are taken, and when they were.
class FrameOptionSet {
 public:
  // what: the images are, as "pairs"; one: one of them.
  void Declare(OptionTable& options, const std::string& what, const std::string& one);
  ImageSourceOptions Options() const;

  const std::string& timestamps() const { return timestamps_; }

 private:
  std::string frames_, timestamps_;
  std::optional<double> frames_per_second_;
};

}  // namespace plumbline::internal
