#pragma once

#include "io/series_frame.h"
#include "match/stereo_sequence.h"
#include "track/adaptive_gauges.h"
#include "track/surface_motion.h"
#include "track/surface_state.h"

// What a series holds, from what was measured.
namespace plumbline::internal {

// `instant`: the surface's, in the frame of the positions; cov_mm2: its random covariance.
Surface SurfaceRecordOf(const StereoSurface& surface, const SurfaceState& instant,
                        const Image<Eigen::Matrix<float, 6, 1>>& cov_mm2, const StereoField& field,
                        SurfaceFrame frame, bool with_covariance);
MatchField MatchRecordOf(const StereoField& field);
DisplacementField DisplacementRecordOf(const SurfaceMotion& motion);
VelocityField VelocityRecordOf(const SurfaceMotion& motion, double seconds);
RigidMotionRecord RigidRecordOf(const SurfaceRigidMotion& rigid);
StrainField StrainRecordOf(AdaptiveStrain adaptive);

// The reference pair, which has not moved by definition: zero, without error, at its valid points.
DisplacementField AtRest(const Image<Status>& status);
void ForgetNoise(StrainField& strain);

// Which frame it is and when, as of `frame`.
void NameAs(const SeriesFrame& frame, SeriesFrame* same);

// The matches again, kOk where there are any, else as `status` has it; the grid as of `like`, whose
// other images are not looked at.
StereoField FieldOf(const MatchField& record, const Image<Status>& status, const PlanarField& like);

}  // namespace plumbline::internal
