#pragma once

#include "calib/stereo_rig.h"

namespace plumbline {

// A stereo rig as one plans it: which sensor, which lens, how far apart, how far away.
struct RigDesign {
  ImageSize image_size{640, 480};
  double lens_mm = 3.5;  // focal length
  double pixel_um = 10;  // side of a pixel
  double baseline_mm = 40;
  double distance_mm = 160;  // from the cameras to the middle of what they look at
  bool converging = false;   // both axes through that middle; else parallel

  double focal_px() const { return 1000 * lens_mm / pixel_um; }

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// The rigs that scenarios come with.
enum class RigKind {
  kWide640,    // 640x480, 3.5 mm lens on a 1/2 inch sensor, 85 degrees of view, 40 mm apart, 160 mm
               // away: the thesis' rig in a tyre
  kWide1280,   // 1280x1024, the same lens
  kLaboratory  // 1280x1024, 25 mm lens, 130 mm apart, converging on a point 500 mm away
};
RigDesign DesignOf(RigKind kind);

// The true cameras of a design, OPENCV5, with the small imperfections of real ones: decentred,
// slightly unlike, not quite parallel, barrel distortion where the view is wide (over 53 degrees).
StereoRig MakeRig(const RigDesign& design);

// ground_from_rig of a rig that looks straight down on the origin from distance_mm: the middle
// between the cameras over the origin, image x along the ground's x, both axes equally steep.
Rigid3 MakeRigPose(const StereoRig& rig, double distance_mm);

}  // namespace plumbline
