#pragma once

#include <string>

#include "calib/internal/npz.h"
#include "calib/optimization_inputs.h"

namespace plumbline::internal {

// OptimizationInputs to and from the archive that .cameramodel files carry: one array a keyword
// argument of mrcal.optimize(), with None as the string ''.
NpzArchive ToNpz(const OptimizationInputs& inputs);

// Throws InputError, `name` saying which file, when an array is missing or has another shape. A
// PINHOLE lens becomes OPENCV4 with its distortion fixed at 0.
OptimizationInputs FromNpz(const NpzArchive& archive, const std::string& name);

}  // namespace plumbline::internal
