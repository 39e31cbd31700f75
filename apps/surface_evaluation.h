#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/stereo_rig.h"
#include "fit/ground_plane.h"
#include "io/series_writer.h"
#include "match/neighbour_correlation.h"
#include "match/stereo_sequence.h"
#include "track/adaptive_gauges.h"
#include "track/camera_motion.h"
#include "track/surface_state.h"
#include "track/surface_strain.h"

namespace plumbline {

struct SurfaceEvaluationOptions {
  EpipolarOptions epipolar;
  GroundPlaneOptions ground;  // without correlation_area_points: see PlaneCovariance()
  // Positions and displacements are told in the ground frame of the reference pair, where a plane
  // is found in it; else, or with false, in the rig frame.
  bool turn_into_ground_frame = true;
  // The frame that positions are told in, where that is known beforehand: then no plane is looked
  // for in the reference pair. Its modes are those of the rig.
  std::optional<MeasurementFrame> known_frame = {};
  bool strain = true;
  // x_direction is set from strain_axes; with x_around set, those are "material".
  SurfaceStrainOptions strain_options;
  // Gauges of strain_options' window or, where strain varies, smaller ones, down to this window
  // (AdaptiveGauges); 0: all have the one window.
  int smallest_strain_window = 0;
  // The local x axis of strains: "material" (growing columns of the grid, or x_around of the
  // options), "ground" (x of the frame that positions are told in) or a direction "x,y,z" in that
  // frame.
  std::string strain_axes = "material";
  bool remove_rigid_motion = false;
  // Whether random sigmas count what subsets do not follow (SubsetSmoothing). Where noise is larger
  // than was said some of it is counted as that.
  bool count_left_out = true;
  bool point_covariance = false;
  bool matches = true;  // also deliver the matches, so that all can be evaluated again
  PoseRefinement refinement = PoseRefinement::kOff;

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

// What one standard deviation of a mode does to the right matches of a pair, where it is not of the
// cameras but of when they expose: px, of the grid. The rig has this mode too, and stands still
// along it.
struct MatchMode {
  std::size_t mode = 0;
  Image<Eigen::Vector2d> right_px;
};

// The motion of a body since the reference pair, in the frame that positions are told in, where
// that is known: a wheel has turned. Displacements then count from the undeformed body at its place
// of this moment.
struct BodyMotion {
  MeasurementFrame now_from_reference;  // along the modes of the rig too
  // The motion when one cause is off by one sigma: those of noise, independent of each other, and
  // those that all frames have in common, beside the modes.
  std::vector<Rigid3> random, common;
  // The frame of this moment that the result is told in, from the one that positions are told in
  // else; the motions above then lead into it.
  std::optional<MeasurementFrame> told_in = {};
  std::optional<MatchMode> match_mode = {};  // of the pair's matches
  // What one sigma of a random error that all right matches of the pair have in common does to them
  // (px, of the grid); it counts in the pose of the cameras. Empty: nothing.
  Image<Eigen::Vector2d> right_common_px = {};
};

// Numbers that sum one frame up, for people: medians over the valid points; NaN without any. Sigmas
// are one standard deviation.
struct SurfaceSummary {
  std::int64_t grid_points = 0;  // that the region and the mask let through
  std::int64_t valid_points = 0;
  std::int64_t strain_points = 0;
  double plane_distance_mm = 0;  // mean z of the plane's points in the rig frame
  Eigen::Vector3d displacement_mm, sigma_random_displacement_mm, sigma_calibration_displacement_mm;
  Eigen::Vector3d strain, sigma_random_strain, sigma_calibration_strain;
};

// From where points are seen to what is published of them: positions, displacements, velocities and
// strains, each with the part of its sigma that is noise and the part that is calibration. It does
// not know of images: `measure` feeds it with fresh matches and `analyse` with stored ones.
//
// Not thread-safe; uses all of TBB's threads, and the result does not depend on their number.
class SurfaceEvaluation {
 public:
  // reference: the matches of the reference pair, and where they have one their own mode.
  // neighbours: of the grid's subsets.
  // Throws UsageError from the options; InputError where no point of the reference pair has a
  // position, with what the epipolar lines say about it.
  SurfaceEvaluation(const StereoRig& rig, StereoField reference, NeighbourCorrelation neighbours,
                    const SurfaceEvaluationOptions& options,
                    const std::optional<MatchMode>& match_mode = {});
  ~SurfaceEvaluation();

  // The header of a series that holds its frames, but for what only the run knows (ids too).
  SeriesHeader Header() const;

  // The points of one pair; time_s in the recording (NaN: no velocity). All of the frame but its
  // index, ids and problem. A frame without a valid point comes back with a problem. With a body's
  // motion there is no ground plane, velocity or rigid motion.
  SeriesFrame Evaluate(const StereoField& field, double time_s, const BodyMotion* body = nullptr);

  // The reference pair itself: at rest by definition, without error.
  SeriesFrame EvaluateReference(double time_s);

  // Forgets the frame before: the next one has no velocity.
  void Restart();

  SurfaceSummary Summarise(const SeriesFrame& frame) const;

  // How many neighbouring points share one noise: the sum of the correlations of a point with all
  // others, the mean over the grid.
  double correlation_area_points() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace plumbline
