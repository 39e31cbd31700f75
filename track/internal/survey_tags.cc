#include "track/internal/survey_tags.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "track/rim_angles.h"

namespace plumbline::internal {

bool LookForTags(const WheelReference& wheel, const GrayImage& left, const GrayImage& right,
                 RollingFrame& frame) {
  if (wheel.tags.family.empty()) return true;
  frame.tags = FindStereoTags(wheel.rig, left, right, wheel.tags.family);
  frame.tag_place = PlaceByTags(wheel, frame.tags);
  frame.problem = frame.tag_place.why;
  return frame.problem.empty();
}

Eigen::MatrixXd HoldToTags(const WheelReference& wheel, RollingWheel& rolling) {
  const bool any = std::any_of(wheel.tags.tags.begin(), wheel.tags.tags.end(),
                               [](const WheelTag& tag) { return tag.on_rim; });
  if (!any) return rolling.deformation.along_modes;
  const RimAngleFinder finder(wheel);
  std::vector<RimAngle> rim;
  std::vector<double> angles, sigmas;
  for (const RollingFrame& frame : rolling.frames) {
    rim.push_back(finder.Find(frame.tags, frame.measured_angle_rad));
    angles.push_back(frame.measured_angle_rad);
    sigmas.push_back(frame.sigma_measured_rad);
  }
  AnglesOfRim held = HoldToRim(angles, sigmas, rolling.deformation.along_modes, rim);
  rolling.twist = held.twist;
  if (!held.twist.known) return rolling.deformation.along_modes;
  rolling.sigma_common_rad = held.sigma_common_rad;
  for (std::size_t f = 0; f < angles.size(); ++f) {
    rolling.frames[f].measured_angle_rad = held.angles_rad[f];
    rolling.frames[f].sigma_measured_rad = held.sigmas_rad[f];
  }
  return std::move(held.along_modes_rad);
}

}  // namespace plumbline::internal
