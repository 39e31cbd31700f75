#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "io/virtual_rig/virtual_rig.h"
#include "tests/support/true_wheel.h"
#include "track/wheel_reference.h"
#include "track/wheel_tracks.h"

namespace plumbline::testing {

inline constexpr double kDegrees = std::numbers::pi / 180;

// The lifted wheel seen by a rig of a quarter of the pixels, so that a turn is rendered in seconds.
class LiftedWheel {
 public:
  static Scenario ScenarioOf(int frames, double step_rad) {
    RigDesign design = DesignOf(RigKind::kWide640);
    design.image_size = {320, 240};
    design.pixel_um *= 2;
    return TurningBy(step_rad, frames,
                     MakeScenario("tyre-lifted", plumbline::MakeRig(design), design.distance_mm));
  }

  LiftedWheel(int frames, double step_rad) : LiftedWheel(ScenarioOf(frames, step_rad)) {}
  explicit LiftedWheel(Scenario scenario)
      : rig_(std::make_unique<VirtualRig>(std::move(scenario))) {}

  const StereoRig& rig() const { return rig_->scenario().rig; }
  int frames() const { return rig_->scenario().frames; }
  const StereoFrame& Pair(int frame) {
    const auto [at, is_new] = pairs_.try_emplace(frame);
    if (is_new) {
      at->second.left = rig_->TakeImage(frame, Side::kLeft);
      at->second.right = rig_->TakeImage(frame, Side::kRight);
    }
    return at->second;
  }
  double Angle(int frame) const { return Wheel(frame).angle_rad - Wheel(0).angle_rad; }
  double CrownRadius() const { return rig_->tyre()->options().section.crown_radius_mm; }
  WheelAxis Axis() const {
    const Rigid3 rig_from_ground = rig_->GroundFromRig(0).Inverse();
    return WheelAxis::Through(rig_from_ground * Eigen::Vector3d(0, 0, Wheel(0).centre_height_mm),
                              rig_from_ground.rotation * Wheel(0).axis);
  }
  WheelState Wheel(int frame) const { return rig_->tyre()->Wheel(rig_->FrameTime(frame)); }
  const VirtualRig& virtual_rig() const { return *rig_; }

 private:
  std::unique_ptr<VirtualRig> rig_;
  std::map<int, StereoFrame> pairs_;
};

inline WheelChainOptions LiftedWheelOptions() {
  WheelChainOptions options;
  options.matching.field.step_px = 17;
  options.matching.field.correlator.subset_px = 17;
  return options;
}

inline GrayImage Wall(const StereoRig& rig) {
  return {Image<std::uint16_t>(rig.left.size(), 90), 8};
}

// All frames, but for those that `blank` names: they see a grey wall.
inline WheelChain ChainOf(LiftedWheel& wheel, const std::vector<int>& blank = {}) {
  WheelChainBuilder builder(wheel.rig(), LiftedWheelOptions());
  const GrayImage wall = Wall(wheel.rig());
  for (int f = 0; f < wheel.frames(); ++f) {
    if (std::count(blank.begin(), blank.end(), f) > 0) {
      EXPECT_FALSE(builder.Add(wall, wall)) << f;
    } else {
      EXPECT_TRUE(builder.Add(wheel.Pair(f).left, wheel.Pair(f).right)) << f;
    }
  }
  return builder.Finish();
}

// What loaded frames are held against, out of all frames of the lifted wheel; `blank` as in
// ChainOf.
inline WheelReference ReferenceOf(LiftedWheel& lifted, const std::vector<int>& blank = {}) {
  WheelTracks tracks(lifted.rig(), ChainOf(lifted, blank), LiftedWheelOptions());
  std::vector<WheelFrameMatches> matches;
  for (int f = 0; f < lifted.frames(); ++f) {
    matches.push_back(tracks.Add(f, lifted.Pair(f).left, lifted.Pair(f).right));
  }
  return MakeWheelReference(lifted.rig(), tracks, matches,
                            AdjustWheel(lifted.rig(), tracks.Problem()));
}

}  // namespace plumbline::testing
