#include "apps/internal/stereo_options.h"

#include <algorithm>

#include "calib/error.h"
#include "io/noise_file.h"

namespace plumbline::internal {

void EvaluationOptionSet::DeclareGround(OptionTable& options) {
  options.Add({.name = "frame",
               .help = "frame of the positions: ground (z up from the plane found; rig where none "
                       "holds) or rig (the left camera)",
               .choices = {"ground", "rig"}},
              &frame_);
  options.Add({.name = "plane-threshold",
               .help = "distance from the plane up to which a point belongs to it; 0: from the "
                       "points' own sigmas and scatter",
               .unit = "mm",
               .min = 0},
              &ground_.inlier_threshold_mm);
  options.Add({.name = "plane-min-share",
               .help = "share of the points that a plane must hold",
               .min = 0.01,
               .max = 1},
              &ground_.min_inlier_fraction);
  options.Add({.name = "point-covariance", .help = "also store the 3x3 covariance of each point"},
              &point_covariance_);
}

void EvaluationOptionSet::Declare(OptionTable& options, StrainOptionSet::Of of) {
  options.Add(
      {.name = "epipolar-tolerance",
       .help = "distance from its epipolar line, beyond the trend of all points and 5 sigmas, at "
               "which a point is a mismatch",
       .unit = "px",
       .min = 0},
      &epipolar_.tolerance_px);
  options.Add({.name = "remove-rigid-motion",
               .help = "take the rigid motion of the whole surface out of the displacements (it is "
                       "stored in any case)"},
              &remove_rigid_motion_);
  options.Add({.name = "refine-pose",
               .help = "when the pose of the right camera is refined from the matches of a frame: "
                       "off (only an alarm is given), significant (where it has moved beyond "
                       "doubt; of a rolling tyre in all frames if it has in one), always",
               .choices = {"off", "significant", "always"}},
              &refine_pose_);
  options.Add({.name = "no-strain", .help = "leave the strain out"}, &no_strain_);
  strain_.Declare(options, of);
  options.Add(
      {.name = "strain-axes",
       .help = "what the local x axis of strains follows: material (columns of the image; of a "
               "rolling tyre, around the wheel), "
               "ground (x of the positions' frame) or a direction in that frame",
       .unit = "NAME|X,Y,Z"},
      &strain_axes_);
}

SurfaceEvaluationOptions EvaluationOptionSet::Options(std::uint64_t seed, bool rolling_tyre) const {
  SurfaceEvaluationOptions options;
  options.epipolar = epipolar_;
  options.ground = ground_;
  options.ground.seed = seed;
  options.turn_into_ground_frame = in_ground_frame();
  options.strain = !no_strain_;
  const AdaptiveGaugesOptions gauges = strain_.OptionsOfSurface(rolling_tyre);
  options.strain_options = gauges.gauge;
  options.smallest_strain_window = gauges.smallest_window_points;
  options.strain_axes = strain_axes_;
  options.remove_rigid_motion = remove_rigid_motion_;
  options.point_covariance = point_covariance_;
  options.refinement = refine_pose_ == "always"        ? PoseRefinement::kAlways
                       : refine_pose_ == "significant" ? PoseRefinement::kWhenSignificant
                                                       : PoseRefinement::kOff;
  options.Check();
  return options;
}

void StereoOptionSet::Declare(OptionTable& options, bool noise_file) {
  matching_.Declare(options, noise_file);
  options.Add({.name = "strategy",
               .help = "how points are followed: reference (the reference subset is found in both "
                       "later images), fresh-stereo (it is followed on the left, and each left "
                       "image matched with its right one), incremental (from image to image)",
               .choices = {"reference", "fresh-stereo", "incremental"}},
              &strategy_);
  options.Add(
      {.name = "update-every",
       .help = "frames after which the reference is taken anew, with --strategy incremental",
       .min = 1,
       .max = 1e9},
      &sequence_.update_every);
  options.Add({.name = "verify-all",
               .help = "look for every point again from every new image; without it that is done "
                       "only where no frame before leads to them"},
              &sequence_.verify_all);
  options.Add({.name = "no-curvature",
               .help = "do not give the curvature between the views to shape functions of order 1"},
              &no_curvature_);
  options.Add({.name = "max-seed-epipolar",
               .help = "distance from its epipolar line beyond which a seed is dropped",
               .unit = "px",
               .min = 1e-3},
              &sequence_.seeds.max_epipolar_px);
  options.Add({.name = "block-frames",
               .help = "frames that start one from the other; a run can be cut between blocks",
               .min = 1,
               .max = 1e9},
              &block_frames_);
  options.Add({.name = "no-matches",
               .help = "do not store the matches; plumbline analyse then cannot work on the run"},
              &no_matches_);
}

StereoStrategy StereoOptionSet::strategy() const {
  const auto found = std::find(kStereoStrategyNames.begin(), kStereoStrategyNames.end(), strategy_);
  return static_cast<StereoStrategy>(found - kStereoStrategyNames.begin());
}

StereoRunOptions StereoOptionSet::Options(std::uint64_t seed, int bits, int step_px,
                                          const SurfaceEvaluationOptions& evaluation) const {
  StereoRunOptions options;
  options.sequence = sequence_;
  options.sequence.strategy = strategy();
  options.sequence.follow_curvature = !no_curvature_;
  options.sequence.field = matching_.Options(seed);
  options.sequence.field.step_px = step_px;
  options.sequence.seeds.seeds = options.sequence.field.seeds;
  if (!noise().empty()) {
    options.sequence.field.correlator.noise = ReadCameraNoise(noise(), "left").ForBits(bits);
    options.sequence.right_noise = ReadCameraNoise(noise(), "right").ForBits(bits);
  }
  options.evaluation = evaluation;
  options.evaluation.matches = !no_matches_;
  options.block_frames = block_frames_;
  options.Check();
  return options;
}

}  // namespace plumbline::internal
