#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// What a series holds of the wheel in one frame. Each record was found or not; sigmas are one
// standard deviation, from independent noise (random) and from the calibration; NaN: not measured.

// The wheel of one frame, as /wheel holds it, in the ground frame. Where it was found, axis and
// centre are numbers; what else was not measured is NaN.
struct WheelRecord {
  bool found = false;
  std::string problem;                                             // why not
  Eigen::Vector3d axis = Eigen::Vector3d::Constant(kNotMeasured);  // unit vector
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Constant(kNotMeasured);
  double radius_mm = kNotMeasured;
  double angle_rad = kNotMeasured;    // turned about the axis since the first frame
  double speed_rad_s = kNotMeasured;  // about the axis
  Eigen::Matrix3d cov_axis_random = Eigen::Matrix3d::Constant(kNotMeasured);
  Eigen::Matrix3d cov_axis_calibration = Eigen::Matrix3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_random_centre_mm = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_calibration_centre_mm = Eigen::Vector3d::Constant(kNotMeasured);
  double sigma_random_radius_mm = kNotMeasured;
  double sigma_calibration_radius_mm = kNotMeasured;
  double sigma_random_angle_rad = kNotMeasured;
  double sigma_calibration_angle_rad = kNotMeasured;
  double sigma_random_speed_rad_s = kNotMeasured;
  double sigma_calibration_speed_rad_s = kNotMeasured;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// What a channel of the wheel's speed does to its angle, as /wheel_channel holds it. Not found: it
// was not used.
struct WheelChannelRecord {
  bool found = false;
  std::string problem;  // why not
  // Share of the turn since the frame before (in the first one: to the next) that follows it.
  double lean = std::numeric_limits<double>::quiet_NaN();
};

// How a frame was found on the wheel, as /placement holds it. Where it was found, placed_by is a
// number: 1, followed from the frames before; 2, by its tags; 3, by its features. The carcass's
// twist is of the whole run, the same in all frames.
struct PlacementRecord {
  bool found = false;
  std::string problem;  // why not
  double placed_by = kNotMeasured;
  double tags = kNotMeasured;  // of the wheel, in both images; those on the rim among them
  double rim_tags = kNotMeasured;
  double unknown_tags = kNotMeasured;   // that the wheel's reference does not have
  double tag_angle_rad = kNotMeasured;  // of the wheel by its tags, 0 to 2 pi
  double twist_rad = kNotMeasured;      // of the surface against the rim
  double sigma_random_twist_rad = kNotMeasured, sigma_calibration_twist_rad = kNotMeasured;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// The contact patch of one frame, as /patch holds it: length along x of the ground frame (the
// direction of travel), width along y. Where it was found, the area is a number.
struct PatchRecord {
  bool found = false;
  std::string problem;  // why not
  double area_mm2 = kNotMeasured;
  double length_mm = kNotMeasured;
  double width_mm = kNotMeasured;
  Eigen::Vector2d centroid_mm = Eigen::Vector2d::Constant(kNotMeasured);  // ground x, y
  double sigma_random_area_mm2 = kNotMeasured;
  double sigma_calibration_area_mm2 = kNotMeasured;
  double sigma_random_length_mm = kNotMeasured;
  double sigma_calibration_length_mm = kNotMeasured;
  double sigma_random_width_mm = kNotMeasured;
  double sigma_calibration_width_mm = kNotMeasured;
  Eigen::Vector2d sigma_random_centroid_mm = Eigen::Vector2d::Constant(kNotMeasured);
  Eigen::Vector2d sigma_calibration_centroid_mm = Eigen::Vector2d::Constant(kNotMeasured);
  double threshold_mm = kNotMeasured;           // that decides what is in contact
  double d_area_d_threshold_mm = kNotMeasured;  // mm^2 of area a mm of threshold
  // Ground x, y; closed, first point not repeated. A row of NaN parts several outlines.
  std::vector<Eigen::Vector2d> contour_mm;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// How the surface slips over the ground, as /slip holds it. Where it was found, the angle is a
// number; the ratio is NaN where nobody knows the radius of free rolling. The velocities of the
// points (in Surface::frame) are there with or without it.
struct SlipRecord {
  bool found = false;
  std::string problem;  // why not
  double ratio = kNotMeasured;
  double angle_rad = kNotMeasured;
  double speed_mm_s = kNotMeasured;           // of the wheel over the ground
  double effective_radius_mm = kNotMeasured;  // travel a radian of the wheel
  double ratio_by_channel = kNotMeasured;     // with a vehicle-speed channel in place of the patch
  double sigma_random_ratio = kNotMeasured;
  double sigma_calibration_ratio = kNotMeasured;
  double sigma_random_angle_rad = kNotMeasured;
  double sigma_calibration_angle_rad = kNotMeasured;
  double sigma_random_speed_mm_s = kNotMeasured;
  double sigma_calibration_speed_mm_s = kNotMeasured;
  double sigma_random_effective_radius_mm = kNotMeasured;
  double sigma_calibration_effective_radius_mm = kNotMeasured;
  double sigma_random_ratio_by_channel = kNotMeasured;
  double sigma_calibration_ratio_by_channel = kNotMeasured;
  // Points in contact of which it is told whether they stick or slide, and of which it is not.
  double sticking = kNotMeasured, sliding = kNotMeasured, undecided = kNotMeasured;
  Image<Eigen::Vector3f> velocity_mm_s;
  Image<Eigen::Vector3f> sigma_random_mm_s;
  Image<Eigen::Vector3f> sigma_calibration_mm_s;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// How a rig that is held by a torque arm stands over the ground, smoothed over the frames, as
// /rig_rotation holds it (RigPose in track/rig_rotation.h). Where it was found, all but the height
// and the sigmas are numbers: on an obstacle of which nothing tells how high it is the height is
// none, and `problem` says so.
struct RigRotationRecord {
  bool found = false;
  std::string problem;  // why not
  double pitch_rad = kNotMeasured, roll_rad = kNotMeasured, height_mm = kNotMeasured;
  double sigma_random_pitch_rad = kNotMeasured, sigma_calibration_pitch_rad = kNotMeasured;
  double sigma_random_roll_rad = kNotMeasured, sigma_calibration_roll_rad = kNotMeasured;
  double sigma_random_height_mm = kNotMeasured, sigma_calibration_height_mm = kNotMeasured;
  double lean = kNotMeasured;  // 0: all from this frame's own plane, 1: all from other frames

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// How the loaded wheel differs from the undeformed one, as /deformation holds it (WheelDeformation
// in track/wheel_deformation.h), in the ground frame. Where it was found, the loaded radius is a
// number.
struct DeformationRecord {
  bool found = false;
  std::string problem;  // why not
  double loaded_radius_mm = kNotMeasured;
  double deflection_mm = kNotMeasured;
  double longitudinal_mm = kNotMeasured, lateral_mm = kNotMeasured;  // mean over the patch
  double radial_mm = kNotMeasured;                                   // largest approach to the axis
  Eigen::Vector3d radial_at_mm = Eigen::Vector3d::Constant(kNotMeasured);
  double sigma_random_loaded_radius_mm = kNotMeasured;
  double sigma_calibration_loaded_radius_mm = kNotMeasured;
  double sigma_random_deflection_mm = kNotMeasured;
  double sigma_calibration_deflection_mm = kNotMeasured;
  double sigma_random_longitudinal_mm = kNotMeasured;
  double sigma_calibration_longitudinal_mm = kNotMeasured;
  double sigma_random_lateral_mm = kNotMeasured, sigma_calibration_lateral_mm = kNotMeasured;
  double sigma_random_radial_mm = kNotMeasured, sigma_calibration_radial_mm = kNotMeasured;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

}  // namespace plumbline
