#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "fit/wheel_axis.h"
#include "match/stereo_sequence.h"

namespace plumbline {

struct WheelChainOptions {
  // How pairs are matched: subset, order, interpolation, noise, seeds. The grid's step is that of
  // the points that are followed: at least as wide as the subset, so that they share no noise.
  // Subsets are small, since a wide view bends them from frame to frame, and what is of third order
  // is not followed: on the virtual rig's tyre 33 px are 21 sigmas off in the angle, 21 px are 2.
  StereoSequenceOptions matching;
  // A new view begins where less than this share of the last one's points is still seen.
  double least_seen_share = 0.6;
  // A frame is placed by so many points of a view, at least, and this share of them.
  int least_points = 16;
  double least_share = 0.12;

  WheelChainOptions() {
    matching.field.step_px = 24;
    matching.field.correlator.subset_px = 21;
  }

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// A frame whose left image stands for the part of the wheel that it shows: the material points of
// its grid are looked for in all other frames that may see them.
struct WheelView {
  int frame = 0;
  double angle_rad = 0;
  GrayImage left, right;
  Eigen::Vector2i first_px{0, 0};
  int step_px = 1;
  Image<Eigen::Vector3d> point_in_rig_mm;  // of that frame's moment; NaN where there is none

  Eigen::Vector2i PixelOf(int row, int column) const {
    return {first_px.x() + column * step_px, first_px.y() + row * step_px};
  }
};

// Where the frames of a turning wheel stand, to a fraction of a degree.
struct WheelChain {
  WheelAxis axis;
  std::vector<double> angles_rad;  // one a frame, the first placed one 0; NaN: not placed
  std::vector<WheelView> views;    // by angle; of a closed turn they cover it once
  // After a full turn the first view was found again, and the angles were stretched to close.
  bool closed = false;
  // What was missing from a full turn by then: as large as the calibration and the chain's errors
  // make it.
  double misclosure_rad = 0;
  double largest_angle_rad() const;
};

// Finds out how a wheel turns in front of a rig that stands still, from one frame to the next: each
// frame is matched with the last view (StereoSequence) and placed by the rigid motion of its
// points, mismatches left out; where too little of that view is left in the picture, the frame
// becomes the next view. All motions share one axis (AxisOfTurns). When the turn is nearly full,
// the first view is looked for again.
//
// Frames that show nothing of the last view are not placed.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class WheelChainBuilder {
 public:
  // mask: of the left image, 0 where something else than the wheel is seen; may be empty. Throws
  // UsageError from the options.
  WheelChainBuilder(const StereoRig& rig, const WheelChainOptions& options,
                    const Image<std::uint8_t>& mask = {});
  ~WheelChainBuilder();

  // The next frame. True where it is placed. Throws InputError where the rig contradicts the images
  // or these change their size.
  bool Add(const GrayImage& left, const GrayImage& right);
  // A frame that could not be read.
  void AddMissing();

  // How far the wheel has turned by now, roughly; 0 before anything is known.
  double turned_rad() const;

  // Throws InputError where no pair could be matched at all, with why, or the wheel hardly turns.
  WheelChain Finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
