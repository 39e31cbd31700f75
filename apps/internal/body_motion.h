#pragma once

#include "apps/surface_evaluation.h"
#include "track/surface_motion.h"
#include "track/surface_state.h"

namespace plumbline::internal {

// The undeformed body at its place of this moment.
SurfaceState UndeformedNow(const SurfaceState& at_reference, const BodyMotion& body);

// The displacement from there, with what is not known of the body's motion in its errors.
SurfaceMotion MotionFromBody(const SurfaceState& at_reference, const SurfaceState& undeformed_now,
                             const SurfaceState& now, const Image<Eigen::Vector3f>& cov_px2,
                             const BodyMotion& body);

}  // namespace plumbline::internal
