#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "apps/surface_evaluation.h"
#include "calib/relative_pose.h"
#include "calib/stereo_rig.h"
#include "calib/triangulate.h"
#include "io/series_frame.h"
#include "track/camera_motion.h"

namespace plumbline::internal {

// Watches, from the matches of each pair, whether the right camera has moved against the left one:
// since the calibration, counting what that is unsure of; and since the reference pair, where all
// that calibration and lenses get wrong cancels.
//
// A pose is refined, where it is, by the motion since the reference pair; that pair itself keeps
// the calibrated pose unless it contradicts it.
class RigWatch {
 public:
  struct Options {
    PoseRefinement refinement = PoseRefinement::kOff;
    CameraMotionLimits limits;
    double alike_points = 1;  // of the observations, that share one noise (RelativePoseOptions)
  };

  // What a pair shows, and the rig to measure it with.
  struct Verdict {
    RigWatchRecord record;
    StereoRig rig;
    // Poses one standard deviation away from the one used, along the independent directions that
    // refined poses may be wrong in: kPoseModes, in the same order in all pairs, or none where no
    // pose was refined. The first half are errors of the reference pair's pose, which all pairs
    // share; the second those of this pair's own.
    std::vector<Rigid3> right_from_left_moved;
  };

  RigWatch(const StereoRig& rig, const Options& options)
      : rig_(rig), options_(options), base_(rig) {}

  // observations: as for RefineRelativePose().
  Verdict Reference(std::span<const StereoObservation> observations);
  // right_common_px: as MotionSince().
  Verdict Later(std::span<const StereoObservation> observations,
                std::span<const Eigen::Vector2d> right_common_px = {}) const;

  static constexpr int kPoseModes = 10;

 private:
  void SetPose(const Eigen::Matrix<double, 6, 1>& change,
               const std::vector<Eigen::Matrix<double, 6, 1>>& errors, Verdict& verdict) const;

  StereoRig rig_;
  Options options_;
  std::optional<RelativePose> first_;
  StereoRig base_;                                        // of the reference pair
  std::vector<Eigen::Matrix<double, 6, 1>> base_errors_;  // that its pose may have; empty: none
};

}  // namespace plumbline::internal
