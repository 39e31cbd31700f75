#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "match/stereo_sequence.h"
#include "track/right_delay.h"
#include "track/wheel_reference.h"

namespace plumbline {

// Where the right camera would have seen the points of a wheel, had it exposed with the left one.
//
// A tyre that rolls steadily keeps its shape under the rig while its material goes through it. So
// what a right image shows of the material at a place of the undeformed wheel, it shows a moment
// later of the material that is there then: with r(q) the right pixel of what the view shows at its
// left pixel q, and q(a) where the view would show the material after a turn by a,
//   d r / d turn = (1 + gradient of the right match) d q / d a,
// in which the deformation is contained. Above an obstacle, which goes with the ground, the shape
// does not stay: FindRightDrift() has what is then left.
class RightFlow {
 public:
  // pair: the matches of the view's own images. Where they have none, as where the right image
  // ends, the view shows the wheel's profile. Keeps no reference.
  RightFlow(const WheelReference& wheel, const StereoField& pair);

  // d right pixel / d turn of the wheel (px a radian) of the view's grid in a pair of images; NaN
  // where the view has no point.
  [[nodiscard]] Image<Eigen::Vector2d> Of(const PlanarField& right) const;

  // That of every `stride`-th point of the grid along its rows and columns.
  [[nodiscard]] RightFlow Every(int stride) const;

 private:
  RightFlow() = default;

  Image<Eigen::Vector2d> left_px_;  // of the view, a radian
};

// The right matches moved by so many times their flow (a turn) or velocity (a time). Those of which
// that is not known are none any more (kExtrapolated).
void MoveAlong(const Image<Eigen::Vector2d>& flow_px, double by, PlanarField* right);

// The same of a point of the undeformed wheel, in the rig frame.
Eigen::Vector2d RigidRightFlow(const WheelReference& wheel, const Eigen::Vector3d& in_rig_mm);

// What a mode of which the cameras know nothing does to points: the right pixels go by right_px.
// moved: (points, modes), of which it fills column `mode` (mm). Sizes as given.
void FillModeOfMatches(const StereoRig& rig, std::span<const Eigen::Vector2d> left,
                       std::span<const Eigen::Vector2d> right,
                       std::span<const Eigen::Vector2d> right_px, std::size_t mode,
                       std::span<Eigen::Vector3f> moved);

// The wheel with the mode of a delay that has a sigma behind those of its calibration; the same
// wheel where it has one or needs none. Throws UsageError where the rig has no modes.
[[nodiscard]] WheelReference WithDelayMode(WheelReference wheel, const RightDelay& delay);

}  // namespace plumbline
