#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "calib/image.h"
#include "fit/surface_points.h"

namespace plumbline {

// How fast the material of a rolling wheel moves, at the points of a grid that is fixed in the rig:
// the material under it changes from frame to frame.

// One frame of the wheel.
struct MaterialFrame {
  double time_s = 0;
  // In the rig, without errors in common. Random: of the place of a given bit of material, the
  // error of what tells which material it is included.
  SurfacePoints points;
  // Of random errors that the points of this frame alone have in common, as those of the cameras'
  // pose: what one sigma of each does to them (rig frame). Empty: none.
  std::vector<Image<Eigen::Vector3f>> along_own_mm;
  // Which material: its angle on the wheel (rad, any turn), its place along the axis (mm) and its
  // undeformed radius (mm).
  Image<Eigen::Vector3d> material;
  UncertainFrame ground;        // of this moment; frame_from_rig is ground_from_rig
  Image<std::uint8_t> contact;  // 1: touches the ground. Empty: not known
};

struct MaterialVelocityOptions {
  // Points of the other frame so near along the surface (mm) tell where material was. 0: 1.7 times
  // the median distance of neighbours in it.
  double reach_mm = 0;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// Which of the neighbouring frames tell a velocity.
enum class VelocityFrom : std::uint8_t { kNone = 0, kBefore, kAfter, kBoth };

struct MaterialVelocity {
  // Relative to the wheel's centre, in the axes of the ground frame of the moment, the turn of the
  // rig against the ground from frame to frame taken out: material that stands still on the ground
  // moves by minus the vehicle's velocity. NaN where not known.
  Image<Eigen::Vector3d> value_mm_s;
  Image<VelocityFrom> from;
  // Over the time since the frame before and until the frame after, each by itself.
  Image<Eigen::Vector3d> before_mm_s, after_mm_s;
  Image<Eigen::Matrix<float, 6, 1>> cov_random_mm2_s2;  // independent noise: xx xy xz yy yz zz
  // What one sigma does of each random error in common (those of the ground frames, then each
  // frame's own) and of each mode; and how it turns the ground frame of the moment (rad).
  std::vector<Image<Eigen::Vector3f>> along_common_mm_s, along_modes_mm_s;
  std::vector<Eigen::Vector3d> turn_along_common_rad, turn_along_modes_rad;

  // How a velocity is made: sum over the three frames (before, this one, after) of
  // per_s[frame] * sum over shares of share * point in that frame's ground frame.
  struct Share {
    std::size_t place = 0;
    double share = 0;
  };
  Image<Eigen::Vector3d> per_s;
  std::array<std::vector<std::vector<Share>>, 3> shares;

  ImageSize size() const { return value_mm_s.size(); }
};

// Up to three frames in a row; `before` and `after` may be null, not both. All have one grid.
struct FrameTriple {
  const MaterialFrame* before = nullptr;
  const MaterialFrame* now = nullptr;
  const MaterialFrame* after = nullptr;
  // How the random errors of their ground frames hang together: what one sigma of each independent
  // one does to each of the three (turn and shift, as UncertainFrame::cov_random has them), one
  // column an error. Empty: each has errors of its own.
  std::array<Eigen::Matrix<double, 6, Eigen::Dynamic>, 3> ground_errors = {};
};

// Where the material of a point was in another frame: the plane that fits that frame's points in
// material coordinates (along the circumference, along the axis) best, within reach, with weights
// (1 - (distance / reach)^2)^2, at the material's own place. Not known where these points do not
// surround it (it lies outside of their convex hull) or are fewer than four.
//
// Both neighbours known: the parabola through the three places, whose error is one sixth of the
// third derivative of the path times the product of both intervals; one: the straight line, half of
// the second derivative times the interval. Where contact is known, a point that touches the ground
// takes only those neighbours in which its material does so too, if there is one: under the tyre
// material moves straight, before and behind it does not (docs/theory.md).
//
// Throws UsageError from the options; std::invalid_argument where grids, modes, contact or numbers
// of errors differ or points have errors in common beside along_own_mm; InputError where the times
// do not grow. The same for any number of threads. Accuracy: tests/track/material_velocity_test.cc.
[[nodiscard]] MaterialVelocity VelocityOfMaterial(const FrameTriple& frames,
                                                  const NeighbourCorrelation& neighbours,
                                                  const MaterialVelocityOptions& options = {});

// The mean velocity with weights (0 or more; of sum 1; 0 where the velocity is not known), with all
// of its errors.
struct MeanVelocity {
  Eigen::Vector3d value_mm_s = Eigen::Vector3d::Zero();
  Eigen::Matrix3d cov_independent = Eigen::Matrix3d::Zero();
  Eigen::Matrix3Xd along_common, along_modes;
};
[[nodiscard]] MeanVelocity MeanOf(const MaterialVelocity& velocity, const FrameTriple& frames,
                                  const Image<double>& weight,
                                  const NeighbourCorrelation& neighbours);

}  // namespace plumbline
