#include "apps/internal/rolling_records.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>

namespace plumbline::internal {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

template <typename Record>
struct Target {
  double Record::*value;
  double Record::*random;
  double Record::*calibration;
};

template <typename Record>
void Put(const MeasuredScalar& scalar, const Target<Record>& to, Record* record) {
  record->*to.value = scalar.value;
  if (!scalar.known()) return;
  record->*to.random = scalar.sigma_random;
  record->*to.calibration = scalar.sigma_calibration();
}

// Why a record was not found; it has to say something.
std::string Reason(const std::string& problem) {
  return problem.empty() ? "it was not found" : problem;
}

}  // namespace

GroundRecord GroundRecordOf(const RigRotationFrame& rotation) {
  GroundRecord record;
  record.found = rotation.found;
  if (!rotation.found) {
    record.problem = Reason(rotation.problem);
    return record;
  }
  const Rigid3& ground = rotation.ground.frame_from_rig;
  record.ground_from_rig = ground;
  record.normal_in_rig = ground.rotation.row(2);
  record.offset_mm = -ground.translation_mm.z();
  record.e1_in_rig = ground.rotation.row(0);
  record.e2_in_rig = ground.rotation.row(1);
  record.centroid_in_rig_mm = ground.Inverse().translation_mm;
  // Pitch turns the normal about e2 and roll about e1; where the axis is higher the ground below
  // it is further away.
  Eigen::Matrix3d J;
  J << 0, 1, 0, 1, 0, 0, 0, 0, -1;
  record.cov_random = J * rotation.cov_random * J.transpose();
  record.cov_calibration.setZero();
  for (const RigPose& mode : rotation.along_modes) {
    const Eigen::Vector3d change = J * mode;
    record.cov_calibration += change * change.transpose();
  }
  if (rotation.along_modes.empty()) record.cov_calibration.setConstant(kNone);
  return record;
}

RigRotationRecord RigRotationRecordOf(const RigRotationFrame& rotation) {
  RigRotationRecord record;
  // The turns are there without the height, as on an obstacle of which nobody said how high it is.
  record.found = rotation.known[0] && rotation.known[1];
  if (!rotation.found) record.problem = Reason(rotation.problem);
  if (!record.found) return record;
  const bool calibration = !rotation.along_modes.empty();
  record.pitch_rad = rotation.pose[0];
  record.roll_rad = rotation.pose[1];
  record.sigma_random_pitch_rad = rotation.sigma_random[0];
  record.sigma_random_roll_rad = rotation.sigma_random[1];
  if (calibration) {
    record.sigma_calibration_pitch_rad = rotation.sigma_calibration[0];
    record.sigma_calibration_roll_rad = rotation.sigma_calibration[1];
  }
  record.lean = rotation.lean;
  if (!rotation.known[2]) return record;
  record.height_mm = rotation.pose[2];
  record.sigma_random_height_mm = rotation.sigma_random[2];
  if (calibration) record.sigma_calibration_height_mm = rotation.sigma_calibration[2];
  return record;
}

PatchRecord PatchRecordOf(const RollingContactFrame& frame, double threshold_mm) {
  const FramePatch& patch = frame.patch;
  PatchRecord record;
  record.found = patch.by != FramePatch::By::kNothing;
  if (!record.found) {
    record.problem = Reason(patch.problem);
    return record;
  }
  const ContactPatch& found = patch.patch;
  if (!found.complete()) {
    record.found = false;
    record.problem = fmt::format(
        "the patch reaches out of what is seen: {:.0f} of the {:.0f} mm of its outline are where "
        "points end; it has {:.0f} mm2 or more",
        found.unseen_perimeter_mm, found.perimeter_mm, found.area_mm2);
    return record;
  }
  record.area_mm2 = found.area_mm2;
  record.length_mm = found.length_mm;
  record.width_mm = found.width_mm;
  record.centroid_mm = found.centroid_mm;
  record.sigma_random_area_mm2 = patch.sigma_random[0];
  record.sigma_random_length_mm = patch.sigma_random[1];
  record.sigma_random_width_mm = patch.sigma_random[2];
  record.sigma_random_centroid_mm = patch.sigma_random.tail<2>();
  if (!frame.rotation.along_modes.empty()) {
    record.sigma_calibration_area_mm2 = patch.sigma_calibration[0];
    record.sigma_calibration_length_mm = patch.sigma_calibration[1];
    record.sigma_calibration_width_mm = patch.sigma_calibration[2];
    record.sigma_calibration_centroid_mm = patch.sigma_calibration.tail<2>();
  }
  record.threshold_mm = patch.by == FramePatch::By::kLiftOff ? 0 : threshold_mm;
  record.d_area_d_threshold_mm = found.d_area_d_threshold_mm;
  for (const Polygon& outline : found.contours_mm) {
    if (!record.contour_mm.empty()) record.contour_mm.emplace_back(kNone, kNone);
    record.contour_mm.insert(record.contour_mm.end(), outline.begin(), outline.end());
  }
  return record;
}

DeformationRecord DeformationRecordOf(const WheelDeformation& deformation) {
  using D = DeformationRecord;
  D record;
  record.found = deformation.loaded_radius_mm.known();
  if (!record.found) {
    record.problem = Reason(deformation.problem);
    return record;
  }
  Put(deformation.loaded_radius_mm,
      {&D::loaded_radius_mm, &D::sigma_random_loaded_radius_mm,
       &D::sigma_calibration_loaded_radius_mm},
      &record);
  Put(deformation.deflection_mm,
      {&D::deflection_mm, &D::sigma_random_deflection_mm, &D::sigma_calibration_deflection_mm},
      &record);
  Put(deformation.longitudinal_mm,
      {&D::longitudinal_mm, &D::sigma_random_longitudinal_mm,
       &D::sigma_calibration_longitudinal_mm},
      &record);
  Put(deformation.lateral_mm,
      {&D::lateral_mm, &D::sigma_random_lateral_mm, &D::sigma_calibration_lateral_mm}, &record);
  Put(deformation.radial_mm,
      {&D::radial_mm, &D::sigma_random_radial_mm, &D::sigma_calibration_radial_mm}, &record);
  if (deformation.radial_mm.known()) record.radial_at_mm = deformation.radial_at_mm;
  return record;
}

SlipRecord SlipRecordOf(const RollingContactFrame& frame, ImageSize grid, int stride) {
  using S = SlipRecord;
  S record;
  const RollingSlip& slip = frame.slip;
  record.found = slip.found;
  if (!slip.found) {
    record.problem = Reason(slip.problem);
    return record;
  }
  Put(slip.ratio, {&S::ratio, &S::sigma_random_ratio, &S::sigma_calibration_ratio}, &record);
  Put(slip.slip_angle_rad,
      {&S::angle_rad, &S::sigma_random_angle_rad, &S::sigma_calibration_angle_rad}, &record);
  Put(slip.speed_mm_s,
      {&S::speed_mm_s, &S::sigma_random_speed_mm_s, &S::sigma_calibration_speed_mm_s}, &record);
  Put(slip.effective_radius_mm,
      {&S::effective_radius_mm, &S::sigma_random_effective_radius_mm,
       &S::sigma_calibration_effective_radius_mm},
      &record);
  Put(slip.ratio_by_channel,
      {&S::ratio_by_channel, &S::sigma_random_ratio_by_channel,
       &S::sigma_calibration_ratio_by_channel},
      &record);
  record.sticking = slip.sticking;
  record.sliding = slip.sliding;
  record.undecided = slip.undecided;
  const Image<Eigen::Vector3f> none(
      grid, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
  record.velocity_mm_s = record.sigma_random_mm_s = record.sigma_calibration_mm_s = none;
  const ImageSize size = slip.over_ground_mm_s.size();
  for (int r = 0; r < size.height && r * stride < grid.height; ++r) {
    for (int c = 0; c < size.width && c * stride < grid.width; ++c) {
      const int row = r * stride, column = c * stride;
      record.velocity_mm_s(row, column) = slip.over_ground_mm_s(r, c).cast<float>();
      record.sigma_random_mm_s(row, column) = frame.sigma_random_mm_s(r, c);
      record.sigma_calibration_mm_s(row, column) = frame.sigma_calibration_mm_s(r, c);
    }
  }
  return record;
}

}  // namespace plumbline::internal
