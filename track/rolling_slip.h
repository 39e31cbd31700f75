#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "calib/image.h"
#include "fit/surface_points.h"
#include "fit/wheel_axis.h"
#include "track/clock_offset.h"
#include "track/material_velocity.h"

namespace plumbline {

// In which sense slip is told. V: velocity of the wheel over the ground, its parts V_x along the
// wheel's heading (perpendicular to the axis, in the ground plane, forwards) and V_y to the left;
// omega: the wheel's angular speed; R_0: the radius of free rolling, V_x / omega without slip.
//
// ISO 8855:2011 (axes x forwards, y to the left, z up):
//   longitudinal slip  s = (omega - omega_0) / omega_0, omega_0 = V_x / R_0: driving is positive;
//   slip angle         alpha = atan2(V_y, V_x): from the heading to the direction of travel,
//                      positive to the left.
// SAE J670e (1976; J670 JAN2008 calls these axes z-down: x forwards, y to the right, z down):
//   longitudinal slip  the same ratio of spin velocities, both at the same V_x, driving positive
//                      (told in percent there, as a ratio here; Blundell and Harty, "The multibody
//                      systems approach to vehicle dynamics", eq. 5.19, turn its sign);
//   slip angle         from the heading to the direction of travel, positive to the right:
//                      -alpha of ISO 8855.
enum class SlipConvention : std::uint8_t { kIso8855 = 0, kSaeJ670 };
inline constexpr std::array<std::string_view, 2> kSlipConventionNames = {"ISO 8855", "SAE J670"};

enum class ContactMotion : std::uint8_t {
  kNoContact = 0,  // or its velocity is not known
  kSticking,
  kSliding,
  kUndecided,  // what it moves by is not told from the threshold
};
inline constexpr std::array<std::string_view, 4> kContactMotionNames = {"no_contact", "sticking",
                                                                        "sliding", "undecided"};

// How the wheel turns in a frame.
struct WheelTurning {
  WheelAxis axis;
  // Of a rotation about the wheel's x, y, z (rad; rotation <- rotation exp(it)) and the distance.
  Eigen::Matrix4d cov_axis_random = Eigen::Matrix4d::Zero();
  // What one sigma of each calibration mode adds to these four (modes, 4). Empty: unknown.
  Eigen::MatrixXd axis_along_modes;
  MeasuredScalar speed_rad_s;  // positive: forwards. No modes: they do not change it
  // What one sigma of each random error in common of the velocities adds to the speed besides
  // (MaterialVelocity::along_common_mm_s). Empty: nothing.
  Eigen::RowVectorXd speed_along_common_rad_s;
};

struct RollingSlipOptions {
  SlipConvention convention = SlipConvention::kIso8855;
  // Material slides where it moves over the ground by more than this share of the vehicle's speed.
  double sliding_share = 0.02;
  double sigmas = 2;     // by which that has to be told
  int least_points = 8;  // in contact, with one velocity

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct RollingSlip {
  bool found = false;  // the speed over the ground and all that follows from it alone
  // What is not there and why, in a sentence; empty: all is.
  std::string problem;
  SlipConvention convention = SlipConvention::kIso8855;

  MeasuredScalar speed_mm_s;  // of the wheel over the ground
  MeasuredScalar slip_angle_rad;
  MeasuredScalar effective_radius_mm;  // V_x / omega
  MeasuredScalar ratio;                // NaN without a free rolling radius
  // By a vehicle-speed channel in place of the patch; NaN without it. And how much faster the
  // channel is than the patch: material that slides all over, a wrong scale or clock show here.
  MeasuredScalar ratio_by_channel;
  MeasuredScalar channel_excess_mm_s;

  Eigen::Vector3d velocity_mm_s = Eigen::Vector3d::Zero();  // of the wheel, in the ground's axes
  Image<ContactMotion> motion;
  // How fast material moves over the ground: its velocity less that of sticking material over the
  // same interval of time, in the ground's axes; and the random sigma of its size.
  Image<Eigen::Vector3d> over_ground_mm_s;
  Image<float> sigma_over_ground_mm_s;
  int sticking = 0, sliding = 0, undecided = 0;  // points
  double used_share = 0;  // of the points in contact with both neighbours: that told the velocity
};

// Slip from how the material in the contact patch moves (VelocityOfMaterial()).
//
// What sticks stands still on the ground, so that it all moves by one and the same velocity against
// the wheel's centre, minus the vehicle's. That is the densest place of the velocities (x, y) of
// the points in contact, refined by Tukey's biweight, w = (1 - (d / 4.685 s)^2)^2 with s the median
// distance from it over 1.1774 (a plane's), held to 1 to 3 median sigmas of the points (Huber,
// Robust Statistics, 1981, chapter 7). Only velocities from both neighbours tell it, from one they
// are of another moment. Where no material sticks, as at a locked wheel, the patch alone cannot
// tell: the channel can.
//
// Material slides where |its velocity - that of sticking material| exceeds the threshold by so many
// sigmas, and sticks where it is below by as many. A velocity is a mean over the interval that it
// is from: edges of the zones are smeared by half the way between frames.
//
// Errors: random, with what neighbours have in common, the ground frames' and the axis'; and along
// each mode, to first order with the weights held.
//
// contact: 1 where the tyre touches the ground. free_rolling_radius_mm: its modes, if of the same
// rig, take part. channel_mm_s: the vehicle's speed at the frame (SpeedFromChannel()).
// found = false with the reason: too few points, the wheel does not roll forwards.
// Throws UsageError from the options, std::invalid_argument where sizes differ.
// Accuracy: tests/track/rolling_slip_test.cc.
[[nodiscard]] RollingSlip MeasureSlip(const MaterialVelocity& velocity, const FrameTriple& frames,
                                      const WheelTurning& wheel, const Image<std::uint8_t>& contact,
                                      const NeighbourCorrelation& neighbours,
                                      const std::optional<MeasuredScalar>& free_rolling_radius_mm,
                                      const std::optional<MeasuredScalar>& channel_mm_s,
                                      const RollingSlipOptions& options = {});

// The radius of free rolling from frames of a run without drive or brake: the mean of its effective
// radii, by their random variances; its random sigma is at least that of their scatter. Nothing
// where fewer than two frames tell one.
[[nodiscard]] std::optional<MeasuredScalar> FreeRollingRadius(std::span<const RollingSlip> run);

// The mean of a channel (straight lines between samples) over the interval of a velocity,
// averaging_s about time_s of our clock. sigma: of one sample, white noise averaged over the
// samples within, and what the clocks' offset adds through the change of speed. Nothing where the
// channel does not reach over it or has a dropout in it.
[[nodiscard]] std::optional<MeasuredScalar> SpeedFromChannel(const SampledSignal& channel_mm_s,
                                                             double time_s, double averaging_s,
                                                             const ClockOffset& offset,
                                                             double sigma_mm_s);

}  // namespace plumbline
