#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "fit/carcass_thickness.h"
#include "track/carcass_estimate.h"
#include "track/ground_observation.h"
#include "track/patch_series.h"
#include "track/rig_rotation.h"
#include "track/rolling_slip.h"
#include "track/rolling_survey.h"
#include "track/wheel_deformation.h"
#include "track/wheel_reference.h"

namespace plumbline {

struct RollingContactOptions {
  CarcassThickness carcass;  // the cameras do not see it
  GroundObservationOptions ground;
  RigRotationOptions rotation;
  PatchSeriesOptions patch;  // noise and correlation are those of the points
  RollingSlipOptions slip;
  WheelDeformationOptions deformation;
  // Of the survey's correlation: how far neighbours go together. A subset of order 2 leans on its
  // middle, so that neighbours have less in common than their subsets share.
  int subset_px = 21, order = 1;
  bool circular = false;
  // The ground by hand in place of the planes: turns about the rig's x, y, z (ManualGround()).
  std::optional<Eigen::Vector3d> manual_turns_deg;
  // Travel a radian at zero slip, and its sigma; and the vehicle's speed by a channel.
  std::optional<MeasuredScalar> free_rolling_radius_mm;
  std::optional<SampledSignal> vehicle_speed_mm_s;
  ClockOffset channel_clock;
  double sigma_vehicle_speed_mm_s = 0;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What a frame says of the ground and of its contact with the tyre. What was not found says why.
struct RollingContactFrame {
  RigRotationFrame rotation;
  FramePatch patch;
  RollingSlip slip;
  // Of slip.over_ground_mm_s, by component.
  Image<Eigen::Vector3f> sigma_random_mm_s, sigma_calibration_mm_s;
  WheelDeformation deformation;
};

// The ground frame of a rotation that was found, with what its pose's errors do to it.
[[nodiscard]] UncertainFrame GroundFrameOf(const RigRotationFrame& rotation, const WheelAxis& axis);

struct RollingContact {
  bool found = false;                       // the ground, in any frame
  std::string problem;                      // why not
  std::vector<RollingContactFrame> frames;  // as RollingWheel::frames
  std::optional<LiftOffLaw> law;
  CarcassThickness carcass;    // corrected by the contact (EstimateCarcass) where it has a sigma
  CarcassCheck carcass_check;  // of the thickness as it was said
};

// From the points of a survey to how the rig stands over the ground, where the tyre touches it, how
// it is deformed and how it slips, frame by frame:
//
//   points -> planes of flat contacts, or symmetry -> smoothed rotation of the rig -> ground
//          -> carcass's thickness by what touches, and again the ground (where it has a sigma)
//          -> contact patch (law of lift-off), deformation, velocity of the material, slip
//
// Ground frames of frames in a row err as the smoother leaves them (RandomCovariance()).
// Where the carcass's thickness has a sigma, reference and survey are those of WithCarcassModes().
// Throws UsageError from the options, InputError as ObserveGround and SmoothRigRotation,
// std::invalid_argument where the reference has fewer modes than the carcass.
// Accuracy: tests/track/rolling_contact_test.cc.
[[nodiscard]] RollingContact FindRollingContact(const WheelReference& reference,
                                                const RollingWheel& rolling,
                                                const RollingContactOptions& options);

// How the ground stands about the axis in each frame, for RollingSurvey::HoldToGround(). A frame in
// which it is not known has that of the nearest one, and a sigma as large as all that it turns by.
// Empty where the ground keeps its pitch to 0.01 degrees, or no frame has any.
[[nodiscard]] std::vector<GroundPitch> GroundPitchesOf(const RollingContact& contact);

}  // namespace plumbline
