#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "io/series_frame.h"
#include "track/right_delay.h"
#include "track/right_delay_estimate.h"

namespace plumbline::internal {

// What `measure` says of a frame of a rolling tyre.
struct RollingReport {
  WheelRecord wheel;
  PlacementRecord placement;
  RigRotationRecord rotation;
  DeformationRecord deformation;
  PatchRecord patch;  // without its contour
  SlipRecord slip;    // without the points
};

// The delay that is taken out of a run and what its images say of it, in ms.
nlohmann::json JsonOf(const RightDelay& used, const RightDelayEstimate& estimate);

// Nothing where the frame is of no rolling tyre.
std::optional<RollingReport> RollingReportOf(const SeriesFrame& frame);

// Lines that begin with two blanks; +- expanded (k = 2).
std::string TextOf(const RollingReport& report);
nlohmann::json JsonOf(const RollingReport& report);

}  // namespace plumbline::internal
