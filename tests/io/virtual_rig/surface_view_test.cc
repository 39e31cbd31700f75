#include "io/virtual_rig/surface_view.h"

#include <gtest/gtest.h>

#include <cmath>

#include "io/virtual_rig/scenario.h"
#include "io/virtual_rig/virtual_rig.h"

namespace plumbline {
namespace {

// Looking at a pixel and projecting what is there must close, and nothing may be nearer.
void ExpectExact(const std::string& name, int frame, double least_share) {
  const VirtualRig rig(MakeScenario(name));
  const double time_s = rig.FrameTime(frame);
  const auto now = rig.surface().At(time_s);
  const SurfaceView view(rig.scenario().rig.left, rig.GroundFromRig(time_s).Inverse(), *now);
  int seen_count = 0, count = 0;
  for (int y = 3; y < view.camera().size().height; y += 23) {
    for (int x = 2; x < view.camera().size().width; x += 19, ++count) {
      const Eigen::Vector2d pixel(x + 0.37, y + 0.61);
      const auto seen = view.Look(pixel);
      if (!seen) continue;
      ++seen_count;
      const SurfacePoint there = now->At(seen->material_mm);
      EXPECT_LT((there.position_mm - seen->surface.position_mm).norm(), 1e-9);
      EXPECT_LT((view.Project(there.position_mm) - pixel).norm(), 1e-8) << pixel.transpose();
      EXPECT_FALSE(view.IsHidden(there.position_mm)) << pixel.transpose();
    }
  }
  EXPECT_GT(seen_count, least_share * count) << name;
}

TEST(SurfaceView, LookingAndProjectingAgree) {
  ExpectExact("incline", 0, 0.9);
  ExpectExact("cylinder", 3, 0.5);
  ExpectExact("tyre-flat", 0, 0.99);
  ExpectExact("cleat-lateral-square38", 5, 0.97);
  ExpectExact("nuts", 6, 0.99);
}

TEST(SurfaceView, WhatABarHidesIsHidden) {
  const VirtualRig rig(MakeScenario("cleat-lateral-square50"));
  const double time_s = rig.FrameTime(3);  // the bar is ahead of the camera
  const auto now = rig.surface().At(time_s);
  const SurfaceView view(rig.scenario().rig.left, rig.GroundFromRig(time_s).Inverse(), *now);
  const double bottom = rig.tyre()->Wheel(time_s).angle_rad * 384;
  const Eigen::Vector3d centre = rig.GroundFromRig(time_s).translation_mm;
  int hidden = 0, visible = 0;
  for (double u = bottom; u < bottom + 220; u += 1) {
    const Eigen::Vector3d p = now->At({u, 10}).position_mm;
    const bool is_hidden = view.IsHidden(p);
    (is_hidden ? hidden : visible) += 1;
    // The line of sight tells for itself: where no material is above it, nothing hides.
    bool blocked = false;
    for (double w = bottom - 40; w < bottom + 240; w += 0.5) {
      const Eigen::Vector3d q = now->At({w, 10}).position_mm;
      if (q.x() <= centre.x() || q.x() > p.x() - 1) continue;
      const double line =
          centre.z() + (p.z() - centre.z()) * (q.x() - centre.x()) / (p.x() - centre.x());
      blocked = blocked || q.z() > line + 0.6;
    }
    if (blocked) {
      EXPECT_TRUE(is_hidden) << u - bottom;
    }
  }
  EXPECT_GT(hidden, 3);
  EXPECT_GT(visible, 100);
}

TEST(SurfaceView, SeesNothingBesideTheSpecimen) {
  SpecimenOptions options;
  options.size_mm = {20, 20};
  const auto specimen = MakeSpecimen(options);
  const auto now = specimen->At(0);
  const StereoRig rig = MakeRig(DesignOf(RigKind::kLaboratory));
  const SurfaceView view(rig.left, MakeRigPose(rig, 500).Inverse(), *now);
  EXPECT_FALSE(view.Look({10, 10}));
  EXPECT_TRUE(view.Look({640, 512}));
}

}  // namespace
}  // namespace plumbline
