#pragma once

#include <span>
#include <vector>

#include "calib/image.h"
#include "fit/carcass_thickness.h"
#include "fit/lift_off.h"
#include "track/patch_series.h"

namespace plumbline::internal {

// A frame's images in a ground frame.
struct InGround {
  Image<Eigen::Vector3d> position_mm, undeformed_mm;
  const Image<double>* thickness_mm;

  // along: what an error does to points and undeformed places, rig frame.
  InGround(const PatchFrame& frame, const Rigid3& ground_from_rig,
           const Image<Eigen::Vector3f>* along = nullptr);
  LiftOffFrame ForLiftOff() const { return {&position_mm, &undeformed_mm, thickness_mm}; }
};

// The frames that stand on flat ground, each in its ground frame, with the thickness of a carcass
// over them and, where it is a map with a sigma, how that goes with the entries.
class FramesOnGround {
 public:
  FramesOnGround(std::span<const PatchFrame> frames, const WheelAxis& axis,
                 const CarcassThickness& carcass);

  // The thickness of another carcass with the same places.
  void SetCarcass(const CarcassThickness& carcass);
  std::vector<LiftOffFrame> ForLiftOff() const;
  // Whether a law holds in any of them.
  bool Holds(const LiftOffLaw& law, const PatchSeriesOptions& options) const;

 private:
  const WheelAxis& axis_;
  std::vector<const PatchFrame*> frames_;
  std::vector<InGround> in_ground_;
  std::vector<Image<double>> thickness_mm_;
  std::vector<Image<ThicknessShares>> shares_;
};

}  // namespace plumbline::internal
