#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <string>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "calib/status.h"

namespace plumbline {

// The frame that a surface's positions are given in.
enum class SurfaceFrame : std::uint8_t { kRig = 0, kGround };

// The surface at the points of a grid in the left image, as /surface of the series holds it. All of
// one size (rows, columns). Values in `frame`; NaN where status is not kOk.
struct Surface {
  Image<Eigen::Vector3f> position_mm;
  Image<Eigen::Vector3f> sigma_random_mm;  // one standard deviation from independent noise
  Image<Eigen::Vector3f>
      sigma_calibration_mm;  // one standard deviation from the calibration, common to all points
  Image<float> correlation;  // NaN where the matcher has none
  Image<float> epipolar_px;
  Image<Status> status;
  SurfaceFrame frame = SurfaceFrame::kRig;
  // Optional (SeriesHeader::has_covariance): random covariance, mm^2, order xx xy xz yy yz zz.
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2;
};

// The ground plane of one frame, as /ground holds it: normal . point = offset, in the rig frame.
struct GroundRecord {
  bool found = false;
  std::string problem;  // why not
  Eigen::Vector3d normal_in_rig = Eigen::Vector3d::Constant(kNotMeasured);
  double offset_mm = kNotMeasured;
  // Order and units of GroundPlane::cov: rotation of the normal about e1 and about e2 (rad), offset
  // along the normal at the centroid (mm).
  Eigen::Matrix3d cov_random = Eigen::Matrix3d::Constant(kNotMeasured);
  Eigen::Matrix3d cov_calibration = Eigen::Matrix3d::Constant(kNotMeasured);
  Rigid3 ground_from_rig;
  double rms_mm = kNotMeasured;
  double inlier_fraction = kNotMeasured;
  // The basis of the covariances, and where their offset is meant. Without them the errors of the
  // angles are NaN.
  Eigen::Vector3d e1_in_rig = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d e2_in_rig = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d centroid_in_rig_mm = Eigen::Vector3d::Constant(kNotMeasured);

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// How the rig stands over the ground, from the normal n (towards the rig, so n_z < 0 seen by it):
//   [0] tilt about the rig's x axis, atan2(n_y, -n_z)
//   [1] tilt about the rig's y axis, atan2(-n_x, -n_z)
//   [2] angle between the ground's normal and the optical axis, atan2(|(n_x, n_y)|, -n_z)
// all 0 where the left camera looks straight down.
struct GroundAngles {
  Eigen::Vector3d angle_rad;
  Eigen::Vector3d sigma_random_rad, sigma_calibration_rad;
};
GroundAngles AnglesOf(const GroundRecord& ground);

struct SeriesFrame {
  std::int64_t index = 0;
  double time_s = 0;
  std::string left_id, right_id;
  std::string problem;  // empty, or why this frame has no surface
  int dropped_before = 0;
  Surface surface;  // empty images where there is a problem
  GroundRecord ground;
};

}  // namespace plumbline
