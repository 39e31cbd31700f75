#pragma once

#include <string>

#include "apps/internal/option_table.h"
#include "track/planar_strain.h"
#include "track/surface_strain.h"

namespace plumbline::internal {

// The options of a strain gauge, the same wherever strain is worked out.
class StrainOptionSet {
 public:
  explicit StrainOptionSet(int window_points) { options_.window_points = window_points; }

  void Declare(OptionTable& options);             // all but the weights
  void DeclareWeights(OptionTable& options);      // of the points of planar gauges
  PlanarStrainOptions Options() const;            // throws UsageError
  SurfaceStrainOptions OptionsOfSurface() const;  // throws UsageError

 private:
  PlanarStrainOptions options_;
  std::string measure_ = "green_lagrange", weights_ = "equal";
};

}  // namespace plumbline::internal
