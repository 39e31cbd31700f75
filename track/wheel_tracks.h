#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "calib/image.h"
#include "calib/stereo_rig.h"
#include "track/wheel_adjustment.h"
#include "track/wheel_chain.h"

namespace plumbline {

// What a frame gave.
struct WheelFrameMatches {
  int looked_for = 0;  // matches of points that should be in the picture, of both images
  int found = 0;
  bool placed = false;  // else its matches are not used
};

// The observations of a wheel's points over a whole recording, for AdjustWheel(): each point of
// each view is looked for in both images of every frame in which it should be seen, always from the
// view's left image, so that nothing drifts; frames one turn later count as well, and close it.
//
// The chain says where a point should be to a few pixels, and how its subset is strained and bent
// there: the correlator starts from that (first and second order, out of where its neighbours on
// the grid go).
//
// Noise. All matches of a point contain the noise of the view's subset, e. The point is taken to be
// where that noise puts it: then the other observations have the noise of their own image alone,
// and that of the view's left pixel is -e. All are independent.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class WheelTracks {
 public:
  // The chain is kept (its images too). mask: of the left image; may be empty.
  WheelTracks(const StereoRig& rig, WheelChain chain, const WheelChainOptions& options,
              const Image<std::uint8_t>& mask = {});
  ~WheelTracks();

  // A frame of the recording that the chain was made of, in any order, once. A frame that the chain
  // has not placed gives nothing.
  WheelFrameMatches Add(int frame, const GrayImage& left, const GrayImage& right);

  const WheelChain& chain() const;

  // Frames and points that were seen too seldom have no observations.
  WheelProblem Problem() const;

  // Where the points of view v begin in the problem, row by row of its grid: point (r, c) is number
  // FirstPoint(v) + r * columns + c, also where there is none.
  int FirstPoint(std::size_t view) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
