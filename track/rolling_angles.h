#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "calib/image.h"

namespace plumbline {

// The angle of a wheel whose surface is deformed, from points of known material.
//
// A loaded tyre does not turn rigidly: its surface is stretched and sheared around the contact by
// more than the angle is wanted to (a degree against a hundredth of it). But seen from the rig the
// deformation hardly changes while the wheel rolls. So what a point i of frame t says,
//   psi_i = phi0_i - Phi_i   (phi0: its angle on the undeformed wheel, Phi: its angle in the rig),
// is the wheel's angle less how far the surface at that place is ahead of the wheel:
//   psi_i = theta_t - delta(Phi_i, y_i) + noise,
// with one delta for all frames: a surface of tensor products of cubic B-splines. All theta and
// delta follow from one linear least-squares problem, reweighted (Tukey's bisquare): what is under
// the wheel for a while, an obstacle, disturbs a part of a frame only, and each place for a part of
// the time only.
//
// Obstacles. What passes under the wheel draws the surface in from before and behind, and that does
// not stand still in the rig: with one delta for all, angles may jump by degrees from before to
// after. So they are held against the turns from frame to frame, which need no delta: the
// differences of psi between two frames at places (means over a third of the knots) where most
// agree are the turn. Where the angles contradict the turns they are not taken: all follow the
// turns (steady = false), chosen so that the speed changes little (dynamic programming over the
// dozen best supported of each pair). What moves the whole of what is seen, in one frame or bit by
// bit, is still taken for a turn: how far places disagree (turn_spread_rad) says what may be.
// Bars on the virtual rig: 0.015 degrees off instead of 2.2; nuts, which there pull the tread along
// by a degree in all: 0.9.
//
// Places: Phi = atan2(x, -z) and y of the wheel frame at angle 0, which is fixed in the rig.
//
// The free constant. A constant of delta and one of all theta cannot be told apart: nothing that
// the cameras see is undeformed for sure. It is held by definition: the mean of the even part of
// delta about the centre, that is of (delta(centre + u, y) + delta(centre - u, y)) / 2, over all
// places that frames show on both sides, is zero. The centre is where the radial deformation is
// most symmetric: the bottom. A tyre that rolls freely stretches evenly to both sides, so that this
// is its angle; driving, braking and cornering shear it by an even part, of which this definition
// takes the mean away. Angles relative to each other do not depend on it. All angles together may
// be off by sigma_common_rad, kHidden times the rms of the even part: of a shear that goes on all
// over the view, only how it changes there can be seen. On the virtual rig the constant is 0.007
// degrees on a tyre that rolls freely (sigma 0.06), 0.35 at 3 % of braking slip (sigma 0.34).
struct RollingObservation {
  double psi_rad = 0;    // continuous within the recording
  double sigma_rad = 0;  // from noise
  double place_rad = 0;  // Phi
  double y_mm = 0;
  double radial_mm = 0;  // radius less the undeformed one
  int block = 0;         // observations of one frame and block may share an error
};

struct RollingAnglesOptions {
  double knot_rad = 0.06, knot_mm = 20;  // of the splines
  double outlier_sigmas = 4.7;           // of Tukey's bisquare

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct RollingAngle {
  double angle_rad = 0;   // NaN: no observation of the frame counts
  double sigma_rad = 0;   // random, of this frame; without what all frames have in common
  double used_share = 0;  // sum of the weights over the number of observations
  // How far places that say otherwise are from the turn since the frame before: sigma by the median
  // deviation of all, times their share.
  double turn_spread_rad = 0;
};

struct RollingAngles {
  std::vector<RollingAngle> frames;
  double sigma_common_rad = 0;
  bool steady = true;           // one delta explains all frames
  double centre_rad = 0;        // of the deformation, Phi
  double scatter = 0;           // of the residuals over their sigmas, robust
  Eigen::MatrixXd along_modes;  // (K, frames), rad: what each column of psi_along does

  // How far the surface at a place is ahead of the wheel (rad); NaN where no frame shows it.
  double Ahead(double place_rad, double y_mm) const;
  // By how much the speed of a frame may be off (rad a unit of time) because places disagree on the
  // turns since the frame before and until the one after, so much time away; 0: there is none.
  double SpeedSpread(std::size_t frame, double since, double until) const;

  static constexpr double kHidden = 4;

  // The splines: knots from these places on.
  double first_place_rad = 0, first_y_mm = 0, knot_rad = 1, knot_mm = 1;
  Image<double> coefficients;  // (row: y, column: place)
  Image<int> seen;             // frames that show each cell between knots
};

// psi_along: of each frame, (observations, K): what one sigma of each calibration mode adds to psi;
// empty where the rig has no modes.
//
// Random errors: sandwich over the blocks of a frame (White, Econometrica 48(4), 1980, in
// clusters), so that what deformation the splines do not follow counts as well, never less than
// the noise; the part of delta's error is counted as that of a mean over the frames.
// times: of the frames, growing, in any unit; empty: as far apart from each other.
// Throws UsageError from the options, std::invalid_argument where sizes do not fit.
// Accuracy: tests/track/rolling_angles_test.cc.
[[nodiscard]] RollingAngles FindRollingAngles(
    std::span<const std::vector<RollingObservation>> frames,
    std::span<const Eigen::MatrixXf> psi_along, const RollingAnglesOptions& options = {},
    std::span<const double> times = {});

}  // namespace plumbline
