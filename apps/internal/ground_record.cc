#include "apps/internal/ground_record.h"

namespace plumbline::internal {

GroundRecord GroundRecordOf(const GroundPlane& plane, const Rigid3& ground_from_rig) {
  GroundRecord ground;
  ground.found = true;
  ground.normal_in_rig = plane.normal;
  ground.offset_mm = plane.offset_mm;
  ground.cov_random = plane.cov;
  ground.ground_from_rig = ground_from_rig;
  ground.rms_mm = plane.rms_mm;
  ground.inlier_fraction = plane.inlier_fraction;
  ground.e1_in_rig = plane.e1;
  ground.e2_in_rig = plane.e2;
  ground.centroid_in_rig_mm = plane.centroid;
  return ground;
}

}  // namespace plumbline::internal
