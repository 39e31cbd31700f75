#pragma once

#include <filesystem>
#include <string>

#include "apps/internal/option_table.h"
#include "track/planar_strain.h"

namespace plumbline::internal {

// The options of a strain gauge, the same wherever strain is worked out.
class StrainOptionSet {
 public:
  explicit StrainOptionSet(int window_points) { options_.window_points = window_points; }

  void Declare(OptionTable& options);
  PlanarStrainOptions Options() const;  // throws UsageError

 private:
  PlanarStrainOptions options_;
  std::string measure_ = "green_lagrange", weights_ = "equal";
};

// Refuses an output that is there already (unless it may be replaced), that is one of the inputs,
// or whose folder is not. Throws InputError, EnvironmentError.
std::filesystem::path CheckedOutput(const std::string& output, bool overwrite);

}  // namespace plumbline::internal
