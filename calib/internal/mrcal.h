#pragma once

// libmrcal 2.2 has no C++ guards. Everything of mrcal that this project calls comes through this
// header.
extern "C" {
#include <mrcal/basic-geometry.h>
#include <mrcal/mrcal.h>
}

#include "calib/camera.h"

namespace plumbline::internal {

mrcal_lensmodel_t ToMrcal(const LensModel& model);
LensModel FromMrcal(const mrcal_lensmodel_t& model);

}  // namespace plumbline::internal
