#pragma once

#include <string>
#include <vector>

#include "calib/calibrate.h"

namespace plumbline::internal {

// What the user should know of a calibration, most important first: one plain sentence each, with a
// remedy.
std::vector<std::string> Warnings(const Calibration& calibration);

// The one thing that would improve it most.
std::string BestImprovement(const Calibration& calibration);

}  // namespace plumbline::internal
