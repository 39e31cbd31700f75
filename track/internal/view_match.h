#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "calib/stereo_rig.h"
#include "match/stereo_sequence.h"
#include "match/subset_correlator.h"
#include "track/wheel_chain.h"

namespace plumbline::internal {

// Both images of a pair, ready to be correlated.
struct PreparedPair {
  PreparedPair(const GrayImage& left, const GrayImage& right,
               const CorrelationImageOptions& options);

  const CorrelationImage& Of(bool right) const { return *images[right ? 1 : 0]; }

  std::optional<CorrelationImage> images[2];
};

// A point of a view that should be in an image, and how its subset should look there.
struct ExpectedPoint {
  int row = 0, column = 0;
  bool right = false;  // which image
  SubsetWarp start;
};

// The inner points of a view that an image of its rig should show after a motion of the wheel
// (now_from_view, rig frame), `room_px` away from its edges.
std::vector<ExpectedPoint> ExpectPoints(const StereoRig& rig, const WheelView& view,
                                        const Rigid3& now_from_view, bool right, double room_px);

// Finds the points of a view in other pairs of the same rig, when the motion since then is known to
// a pixel or two: the subset starts displaced, strained and bent as its neighbours on the grid
// move. Points without all eight neighbours are left out: their bend is not known, and leaving it
// out would bias them by a tenth of a pixel where the view is wide.
class ViewMatcher {
 public:
  // The view and the rig must outlive it.
  ViewMatcher(const StereoRig& rig, const WheelView& view, const StereoSequenceOptions& options,
              const Image<std::uint8_t>& mask);

  const WheelView& view() const { return view_; }

  std::vector<ExpectedPoint> Expect(const Rigid3& now_from_view, bool right) const;

  SubsetMatch Match(const PreparedPair& pair, const ExpectedPoint& point) const;

  // How well the left image agrees with this motion: the median correlation of some points spread
  // over the view; -1 where hardly any should be seen.
  double Score(const PreparedPair& pair, const Rigid3& now_from_view) const;

 private:
  const StereoRig& rig_;
  const WheelView& view_;
  CorrelationImage image_;
  SubsetCorrelator left_, right_;
};

// The second order of a motion is known beforehand or not at all.
CorrelatorOptions Across(const StereoSequenceOptions& options);

// The surface in a new pair where it can hardly differ from that in the last one, seen by the same
// rig: right matches with shape functions of second order from where the last surface lies at the
// same pixels. Points are NaN where that finds nothing, or off the epipolar line.
Image<Eigen::Vector3d> SurfaceLike(const StereoRig& rig, const WheelView& last,
                                   const GrayImage& left, const PreparedPair& pair,
                                   const StereoSequenceOptions& options,
                                   const Image<std::uint8_t>& mask);

}  // namespace plumbline::internal
