#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/internal/option_table.h"
#include "track/adaptive_gauges.h"
#include "track/planar_strain.h"

namespace plumbline::internal {

// The options of a strain gauge, the same wherever strain is worked out.
class StrainOptionSet {
 public:
  // What strain is worked out of: a gauge of one point is that of a planar subset alone.
  enum class Of : std::uint8_t { kPlanar, kSurface, kEither };

  void Declare(OptionTable& options, Of of);
  PlanarStrainOptions Options() const;  // throws UsageError
  // Of a surface. rolling_tyre: what is not given is then what suits its curved, uneven strain
  // (docs/rolling_tyre.md). Throws UsageError.
  AdaptiveGaugesOptions OptionsOfSurface(bool rolling_tyre = false) const;

 private:
  std::optional<int> window_points_, order_, smallest_window_points_;
  PlanarStrainOptions options_;
  std::string measure_ = "green_lagrange", weights_ = "equal";
};

}  // namespace plumbline::internal
