#pragma once

#include <cstdint>
#include <string>

#include "apps/internal/option_table.h"
#include "track/planar_strain.h"
#include "track/surface_strain.h"

namespace plumbline::internal {

// The options of a strain gauge, the same wherever strain is worked out.
class StrainOptionSet {
 public:
  // What strain is worked out of: a gauge of one point is that of a planar subset alone.
  enum class Of : std::uint8_t { kPlanar, kSurface, kEither };

  explicit StrainOptionSet(int window_points) { options_.window_points = window_points; }

  void Declare(OptionTable& options, Of of);
  PlanarStrainOptions Options() const;            // throws UsageError
  SurfaceStrainOptions OptionsOfSurface() const;  // throws UsageError

 private:
  PlanarStrainOptions options_;
  std::string measure_ = "green_lagrange", weights_ = "equal";
};

}  // namespace plumbline::internal
