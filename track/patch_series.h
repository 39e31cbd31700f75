#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/image.h"
#include "fit/carcass_thickness.h"
#include "fit/contact_patch.h"
#include "fit/lift_off.h"
#include "match/neighbour_correlation.h"
#include "track/rig_rotation.h"

namespace plumbline {

// The contact patch of every frame of a rolling tyre, in the ground frame of the frame.
//
// Definition: contact is where the carcass's law of lift-off has it begin (fit/lift_off.h), the law
// being that of all frames together. Where that does not hold (over an obstacle), the patch is what
// lies within a threshold of the ground (fit/contact_patch.h), which is larger, and says so.
struct PatchFrame {
  Image<Eigen::Vector3d> point_mm;       // inner surface, rig frame; NaN where there is none
  Image<Eigen::Vector3d> undeformed_mm;  // of the same material at the same wheel angle, rig frame
  Image<double> thickness_mm;            // of the carcass (ThicknessOver)
  Image<Eigen::Matrix3d> cov_mm2;        // of the points, from noise
  // What each calibration mode does to the points, rig frame; it is taken to do the same to their
  // undeformed places. As many as rotation.ground.along_modes, or none.
  std::vector<Image<Eigen::Vector3f>> along_modes_mm;
  RigRotationFrame rotation;
  // The thickness along the last ones of the modes, which are the carcass's; along the others it is
  // what it is.
  std::vector<Image<double>> thickness_along_modes = {};
  // What one sigma of each direction of the frame's own pose of the cameras does to the points and,
  // as it is taken, to their undeformed places: random.
  std::vector<Image<Eigen::Vector3f>> along_pose_mm = {};
};

struct PatchSeriesOptions {
  LiftOffOptions lift_off;
  ContactPatchOptions threshold;
  double sigma_mm = 0.05;              // of the points along the ground's normal, from noise
  double correlation_area_points = 1;  // as in GroundPlaneOptions
  std::optional<LiftOffLaw> law;       // that of another run of the same tyre
  // What the law leaves out, as errors of the undeformed depth at which the tyre leaves the ground:
  // all round, and of opposite sign along and across (docs/theory.md, section 22).
  double sigma_depth_mm = 0.04, sigma_ellipse_mm = 0.1;
  // Of the frames' thickness_mm. Where it is a map with a sigma the law counts what may be wrong
  // with it (FitLawAndThickness), and along its modes goes with them.
  CarcassThickness carcass = {{}, {0}};

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct FramePatch {
  enum class By { kNothing, kLiftOff, kThreshold };
  By by = By::kNothing;
  std::string problem;  // kNothing, kThreshold: why
  ContactPatch patch;   // of kLiftOff, d_area_d_threshold_mm counts mm of undeformed depth
  // Of ContactPatch::results(). From noise (the points', the law's, the ground's, that of the
  // frame's pose of the cameras) and from the calibration. By the threshold NaN where an error of
  // one sigma leaves no patch; by the law such an error is not counted. By the threshold, of what
  // lies within the threshold: how much more than what touches that is, no sigma tells.
  using Results = ContactPatch::Results;
  Results sigma_random = Results::Zero(), sigma_calibration = Results::Zero();
  // The part of sigma_random that is the law's, and so common to all frames: from noise, and what
  // it leaves out.
  Results sigma_law = Results::Zero();
  // Within the threshold, whatever `by` says.
  std::optional<ContactPatch> within_threshold;
};

struct PatchSeries {
  std::optional<LiftOffLaw> law;  // none: no frame shows it
  std::vector<FramePatch> frames;
};

// axis: of the wheel, rig frame. neighbours: how the noise of points of the grid goes together.
// Frames whose rotation was not found have no patch. The errors of the ground are taken as
// independent of those of the points at the boundary.
// Throws UsageError from the options, std::invalid_argument where sizes or numbers differ.
// Accuracy: tests/track/patch_series_test.cc.
[[nodiscard]] PatchSeries FindPatches(std::span<const PatchFrame> frames, const WheelAxis& axis,
                                      const NeighbourCorrelation& neighbours,
                                      const PatchSeriesOptions& options = {});

}  // namespace plumbline
