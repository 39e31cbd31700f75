#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "calib/image.h"
#include "calib/rigid3.h"
#include "calib/status.h"
#include "io/series_shard.h"
#include "io/wheel_records.h"

namespace plumbline {

// What the file says about itself.
struct SeriesFacts {
  std::string created;   // ISO 8601, UTC
  std::string software;  // that wrote it
  std::string recipe_toml;
  std::string inputs_json;           // [{"path", "size", "sha256"}]
  std::optional<SeriesShard> shard;  // nothing: the run is whole
  bool goes_on = false;  // the run was not finished when the file was written: more will come
};

// Which optional groups a series holds; fixed for the whole run.
struct SeriesContents {
  bool covariance = false;  // /surface/covariance
  bool displacement = false;
  bool strain = false;
  bool wheel = false;
  bool patch = false;
  bool slip = false;
  bool matches = false;         // /match
  bool velocity = false;        // /velocity
  bool rigid_motion = false;    // /rigid_motion
  bool rig_watch = false;       // /rig_watch
  bool rig_rotation = false;    // /rig_rotation
  bool deformation = false;     // /deformation
  bool material = false;        // /material
  bool strain_windows = false;  // a gauge at each point: /strain/window_points, the model's errors
  bool wheel_channel = false;   // /wheel_channel
  bool placement = false;       // /placement
  bool survey = false;          // /survey

  friend bool operator==(const SeriesContents&, const SeriesContents&) = default;
};

// The names of those that it holds, in the order above.
std::vector<std::string> Names(const SeriesContents& contents);

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
  // Optional (SeriesContents::covariance): random covariance, mm^2, order xx xy xz yy yz zz.
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

// How far the points of the surface have moved, as /displacement holds it, in Surface::frame. Like
// all fields of points: of the size of the grid, or empty where the frame has none; NaN where the
// surface's status is not kOk, and where there is a surface and yet no value.
struct DisplacementField {
  Image<Eigen::Vector3f> value_mm;
  Image<Eigen::Vector3f> sigma_random_mm;
  Image<Eigen::Vector3f> sigma_calibration_mm;
};

// Which material the points are, as /material holds it: their places on the undeformed wheel, in
// the wheel frame of its reference. Under the rules of DisplacementField.
struct MaterialField {
  Image<Eigen::Vector3f> position_mm;
};

// The velocity of the points, as /velocity holds it, in Surface::frame; under the rules of
// DisplacementField.
struct VelocityField {
  Image<Eigen::Vector3f> value_mm_s;
  Image<Eigen::Vector3f> sigma_random_mm_s;
  Image<Eigen::Vector3f> sigma_calibration_mm_s;
};

// Where each point is seen, and how sure, as /match holds it: what all else follows from without
// correlating again. Numbers at each point that both images were matched at, whatever the surface's
// status says of what became of it; what a matcher cannot tell is NaN.
struct MatchField {
  // The pixel in that image now, less the grid's pixel.
  Image<Eigen::Vector2f> left_displacement_px, right_displacement_px;
  // Of these displacements along x and y of the image that the grid lies in:
  // (du/dx du/dy; dv/dx dv/dy).
  Image<Eigen::Matrix2f> left_gradient, right_gradient;
  // Random covariance of these pixels, uu, uv, vv, and how much of it (0 to 1) comes from the noise
  // of the reference image: that part is common to all matches of one subset.
  Image<Eigen::Vector3f> left_cov_px2, right_cov_px2;
  Image<float> left_reference_share, right_reference_share;
};

// What the first pass over a rolling tyre saw of a frame, as /survey holds it: the wheel's angle,
// the ground and all that is told of the contact follow from it and the wheel's reference without
// the images. Where it was found, its numbers are numbers.
struct SurveyRecord {
  bool found = false;
  std::string problem;               // why the frame is not on the wheel
  double view = kNotMeasured;        // of the wheel's reference, from 0, that it was matched with
  double near_rad = kNotMeasured;    // the wheel's angle near which it was looked for
  double spacing_px = kNotMeasured;  // of the points, in the view's left image
  // Of the view's points that lie so far apart, from the first point of the grid on; NaN elsewhere.
  // Displacements are as seen, before a delay of the right camera is taken out.
  MatchField match;
  // The tags that it shows, as JSON: {"tags": [{"id", "left_px", "right_px"}], "twice": [id]}, with
  // four corners each; empty where none were looked for.
  std::string tags;

  static constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
};

// The matches of the pair that displacements count from, as /reference holds them, whether it is
// one of the frames or not: all else follows from these and those of a frame. NaN where the status
// is not kOk.
struct ReferenceMatches {
  std::string left_id;  // as SeriesFrame's
  MatchField match;
  Image<Status> status;
};

// The strain as /strain holds it, of the measure that the header names: xx, yy, xy in the local
// axes of the surface, xy the tensor's shear component (half of the engineering shear). Without
// unit. NaN where `status` is not kOk, which is the strain's own: a point may have a position and
// no strain (at an edge the gauge is not full).
struct StrainField {
  Image<Eigen::Vector3f> value;
  Image<Eigen::Vector3f> sigma_random;
  Image<Eigen::Vector3f> sigma_calibration;
  Image<Status> status;
  // Written where SeriesContents::strain_windows is set: the side of each point's gauge in points,
  // and one standard deviation of what the polynomial over it leaves out.
  Image<float> window_points;
  Image<Eigen::Vector3f> sigma_model;
  // Written where SeriesContents::covariance is set. From independent noise, upper triangle row by
  // row: xx xx, xx yy, xx xy, yy yy, yy xy, xy xy.
  Image<Eigen::Matrix<float, 6, 1>> cov_random;
  // Of what follows from the components (StrainInvariants in track/strain_measure.h). Each may be
  // empty: then it is NaN in the file.
  Image<Eigen::Vector2f> sigma_random_principal, sigma_calibration_principal;
  Image<float> sigma_random_angle_rad, sigma_calibration_angle_rad;
  Image<float> sigma_random_max_shear, sigma_calibration_max_shear;
  Image<float> sigma_random_von_mises, sigma_calibration_von_mises;
};

// The principal strains of (xx, yy, xy), the larger one first, and the angle of the first one's
// direction from the local x axis towards y, in (-pi/2, pi/2]: NaN where both are equal, since
// every direction is then a principal one.
struct PrincipalStrain {
  Eigen::Vector2f strain;
  float angle_rad;
};
PrincipalStrain PrincipalOf(const Eigen::Vector3f& strain);

// The rigid motion of the whole surface since the reference, as /rigid_motion holds it:
// in Surface::frame: a turn about the centroid of the points, and the way of the centroid. Where it
// was found, both vectors are numbers.
struct RigidMotionRecord {
  bool found = false;
  std::string problem;                                                     // why not
  Eigen::Vector3d rotation_rad = Eigen::Vector3d::Constant(kNotMeasured);  // axis times angle
  Eigen::Vector3d translation_mm = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_random_rotation_rad = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_calibration_rotation_rad = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_random_translation_mm = Eigen::Vector3d::Constant(kNotMeasured);
  Eigen::Vector3d sigma_calibration_translation_mm = Eigen::Vector3d::Constant(kNotMeasured);

  static constexpr double kNotMeasured = GroundRecord::kNotMeasured;
};

// Whether the right camera has moved against the left one, as /rig_watch holds it. Where it was
// found, the rms distance from the epipolar lines and the pose used in this frame are numbers.
struct RigWatchRecord {
  bool found = false;
  std::string problem;  // why not
  double epipolar_mean_px = kNotMeasured;
  double epipolar_rms_px = kNotMeasured;
  double epipolar_sigma_px = kNotMeasured;  // the rms that the matches' noise lets expect
  double chi2_calibration = kNotMeasured;   // of the pose of this frame less the calibrated one
  double chi2_first = kNotMeasured;         // of the pose of this frame less that of the first one
  // The pose of this frame less the calibrated one: rotation vector (rad), translation (mm).
  Eigen::Matrix<double, 6, 1> change = Eigen::Matrix<double, 6, 1>::Constant(kNotMeasured);
  Eigen::Matrix<double, 6, 1> sigma_random_change =
      Eigen::Matrix<double, 6, 1>::Constant(kNotMeasured);
  Eigen::Matrix<double, 6, 1> sigma_calibration_change =
      Eigen::Matrix<double, 6, 1>::Constant(kNotMeasured);
  bool refined = false;    // that pose was used for this frame, not the calibrated one
  bool alarm = false;      // the camera has moved
  Rigid3 right_from_left;  // used in this frame

  static constexpr double kNotMeasured = GroundRecord::kNotMeasured;
};

struct SeriesFrame {
  std::int64_t index = 0;
  double time_s = 0;
  std::string left_id, right_id;
  std::string problem;  // empty, or why this frame has no surface
  int dropped_before = 0;
  Surface surface;  // empty images where there is a problem
  GroundRecord ground;
  // Written where the series' contents name them.
  DisplacementField displacement;
  StrainField strain;
  WheelRecord wheel;
  PatchRecord patch;
  SlipRecord slip;
  MatchField match;
  VelocityField velocity;
  RigidMotionRecord rigid_motion;
  RigWatchRecord rig_watch;
  RigRotationRecord rig_rotation;
  DeformationRecord deformation;
  WheelChannelRecord wheel_channel;
  MaterialField material;
  PlacementRecord placement;
  SurveyRecord survey;
};

}  // namespace plumbline
