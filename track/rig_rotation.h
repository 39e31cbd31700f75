#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/image.h"
#include "fit/deformation_symmetry.h"
#include "fit/ground_plane.h"
#include "fit/wheel_axis.h"
#include "track/surface_state.h"

namespace plumbline {

// How the ground lies against a rig that turns about the wheel's axis, over time.
//
// The rig is held by a torque arm and does not turn with the wheel; the axis stays where it is in
// the rig frame, the ground does not. A pose is, in this order, about the wheel frame at wheel
// angle 0 (WheelAxis: y along the axis, z from the ground to the left camera),
//   pitch   about the axis, from the wheel frame's z to the ground's normal, positive from z to x;
//   roll    of the ground about the wheel frame's x turned by the pitch;
//   height  of WheelAxis::origin_in_rig_mm() above the ground, along its normal:
//   normal in wheel frame = (sin pitch cos roll, -sin roll, cos pitch cos roll).
using RigPose = Eigen::Vector3d;  // rad, rad, mm
RigPose PoseOf(const GroundPlane& plane, const WheelAxis& axis);
// d pose / d (turn about e1, turn about e2, shift of the plane): the order of GroundPlane::cov.
Eigen::Matrix3d PoseJacobian(const GroundPlane& plane, const WheelAxis& axis);
GroundPlane PlaneOf(const RigPose& pose, const WheelAxis& axis);
// ground_from_rig as in RigRotationFrame::ground.
Rigid3 GroundOf(const RigPose& pose, const WheelAxis& axis);
// How that frame turns and shifts (as UncertainFrame::cov_random has it) with the pose.
Eigen::Matrix<double, 6, 3> GroundJacobian(const RigPose& pose, const WheelAxis& axis);

// Errors that are the same in all frames, in sigmas, while what one sigma does differs from frame
// to frame: of a lasting asymmetry or of the carcass's thickness, and of the edge of narrow
// contacts. Where a bar moves through the contact, a stiff arm tells them.
inline constexpr std::size_t kPoseCommon = 2;

// The flat top of an obstacle that the tyre stands on. How high it is above the ground is not
// known by itself: that is told by the frames in which ground is touched beside it, as long as it
// is the same top, or by the user.
struct ObstacleTop {
  double below_axis_mm = 0;  // of WheelAxis::origin_in_rig_mm(), along the normal
  // Random: with the frame's pitch, roll and height, and of itself.
  Eigen::Vector4d cov = Eigen::Vector4d::Zero();
  std::array<double, kPoseCommon> common_mm{};
  std::vector<double> along_modes_mm;  // less below_axis_mm
  bool as_before = false;  // the same as that of the last frame before this one that has a top
};

// What one frame says about the pose by itself.
struct PoseObservation {
  // kTurns: of an obstacle's top, parallel to the ground: pitch and roll.
  enum class Of { kNothing, kPitch, kTurns, kPlane };
  double time_s = 0;
  Of of = Of::kNothing;
  RigPose pose = RigPose::Zero();  // kPitch, kTurns: the first one, two entries alone
  Eigen::Matrix3d cov = Eigen::Matrix3d::Zero();  // random; likewise
  std::array<RigPose, kPoseCommon> common = {RigPose::Zero(), RigPose::Zero()};
  std::vector<RigPose> along_modes;  // less `pose`, one a calibration mode
  std::optional<ObstacleTop> top;    // kTurns, kPlane
  bool over_obstacle = false;        // from narrow contacts (fit/contact_levels.h)
  std::string why;                   // not kPlane: why there is no plane
};
// plane.cov is taken as it is. along_modes, axis_along_modes: plane and axis as each calibration
// mode has them, or both empty. Throws std::invalid_argument where their numbers differ.
PoseObservation ObservePlane(double time_s, const GroundPlane& plane, const WheelAxis& axis,
                             std::span<const GroundPlane> along_modes = {},
                             std::span<const WheelAxis> axis_along_modes = {});
PoseObservation ObservePitch(double time_s, const DeformationSymmetry& symmetry,
                             std::span<const double> pitch_along_modes_rad = {});

struct RigRotationOptions {
  // How fast the arm lets the rig turn: the pose walks at random, its sigma after a second being
  // this. Without values the noise, and whether it drives the pose or its rate, are those under
  // which the frames are likeliest.
  std::optional<double> pitch_deg_per_sqrt_s, roll_deg_per_sqrt_s, height_mm_per_sqrt_s;
  // On top of it where a frame or the one before it has no plane: the axle rises over what is
  // there.
  double unseen_height_mm_per_sqrt_s = 60;
  // What is known from elsewhere (a run on flat ground, the vehicle's camber) of the first frame:
  // pose and sigmas. Infinite where nothing is.
  RigPose prior = RigPose::Zero();
  RigPose prior_sigma = RigPose::Constant(std::numeric_limits<double>::infinity());
  // Height above the ground of the flat tops that are stood on; its sigma infinite where nothing is
  // known of it.
  double obstacle_height_mm = 0;
  double sigma_obstacle_height_mm = std::numeric_limits<double>::infinity();
  // A frame that is less likely than this under all others is left out.
  double outlier_share = 1e-5;
  // A pose less sure than this is none.
  double max_sigma_rad = 0.009, max_sigma_height_mm = 20;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// How the random errors of smoothed frames hang together. What is smoothed is a state (pitch, its
// rate, roll, height, its rate, height of the top stood on, and the errors that frames have in
// common, in their sigmas) that follows from the one before and noise: with the smoother's gains G
// the errors of two frames a < b have
//   cov(x_a, x_b) = G_a G_a+1 ... G_b-1 P_b
// (the lag-one covariance smoother, Shumway and Stoffer, J. Time Series Analysis 3(4), 1982,
// further on).
struct PoseErrors {
  static constexpr int kState = 6 + static_cast<int>(kPoseCommon);
  using Matrix = Eigen::Matrix<double, kState, kState>;
  Matrix cov = Matrix::Zero();   // P, of the state
  Matrix gain = Matrix::Zero();  // G, to the next frame
};

struct RigRotationFrame {
  enum class From { kPlane, kObstacle, kPitch, kSmoother, kOutlier };
  double time_s = 0;
  bool found = false;           // all of the pose
  std::array<bool, 3> known{};  // each entry of the pose
  std::string problem;          // where it was not found, or leaned wholly on others: why
  From from = From::kSmoother;
  RigPose pose = RigPose::Zero();
  Eigen::Matrix3d cov_random = Eigen::Matrix3d::Zero();
  PoseErrors errors;                 // that cov_random is of
  std::vector<RigPose> along_modes;  // less `pose`
  RigPose sigma_random = RigPose::Zero(), sigma_calibration = RigPose::Zero();
  // kObstacle: from narrow contacts, on an obstacle or beside it.
  // How much of the angles comes from other frames: 0 all from its own plane, 1 nothing of it.
  double lean = 1;
  // z along the ground's normal, x where the wheel heads (the axis times z; the direction of travel
  // is off it by the slip angle), origin on the ground below the axis' origin. Not where !found.
  MeasurementFrame ground;
};

struct RigRotation {
  std::vector<RigRotationFrame> frames;
  bool found = false;   // in any frame
  std::string problem;  // why in none
  bool with_rate = false;
  // Of the process: rad, rad and mm a sqrt(s) where it walks; with_rate, pitch and height (not
  // roll) are driven by their rates, rad and mm a s^1.5.
  RigPose noise = RigPose::Zero();
  int outliers = 0;
};

// A Kalman filter and the smoother of Rauch, Tung and Striebel (AIAA J. 3(8), 1965) over the frames
// in order of time. The pose walks at random, or (the arm swings with the vehicle) pitch and height
// have a rate that does. The noise is that of the largest likelihood of the innovations, in which
// an observation may with a chance of 1 % be anywhere (20 degrees, 100 mm): so that one bad plane
// does not make the arm soft. Those that are likelier bad are left out, and those that the smoothed
// rest contradicts (chi-square, outlier_share).
//
// Calibration modes go through the same gains, the smoother being linear; the sigma of the
// calibration is common to all frames. axis_along_modes: as in ObservePlane(); empty: the axis is
// exact. The axis' random error is not in it.
//
// Throws UsageError from the options, InputError where times do not ascend, std::invalid_argument
// where numbers of modes differ. Accuracy: tests/track/rig_rotation_test.cc.
[[nodiscard]] RigRotation SmoothRigRotation(std::span<const PoseObservation> frames,
                                            const WheelAxis& axis,
                                            std::span<const WheelAxis> axis_along_modes = {},
                                            const RigRotationOptions& options = {});

// Of the random errors of the poses of frames a <= b, in a row: a's entries by b's.
[[nodiscard]] Eigen::Matrix3d RandomCovariance(std::span<const RigRotationFrame> frames,
                                               std::size_t a, std::size_t b);
// Of how far the ground turns in the rig, about the wheel's axis, from a to b.
[[nodiscard]] double SigmaOfTurn(std::span<const RigRotationFrame> frames, std::size_t a,
                                 std::size_t b);
// What one sigma of each independent random error does to the poses of all frames, one below the
// other: a root of their joint covariance.
[[nodiscard]] Eigen::MatrixXd RandomRoot(std::span<const RigRotationFrame> frames);

// By hand: the rig turned about its own x, then y, then z axis (as they stand) by constant angles,
// and moved along the turned z so that the lowest of the undeformed points is at z = 0. The
// origin lies below the axis, or, without one, below the left camera. Throws InputError where no
// point is there.
[[nodiscard]] Rigid3 ManualGround(const Eigen::Vector3d& turns_deg,
                                  const Image<Eigen::Vector3d>& undeformed_in_rig_mm,
                                  const std::optional<WheelAxis>& axis = std::nullopt);

}  // namespace plumbline
