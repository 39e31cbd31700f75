#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/board.h"
#include "calib/stereo_rig.h"

namespace plumbline {

struct OptimizationInputs;

// From detected boards to a calibrated stereo rig with an honest covariance.
//
// The steps, in order (DESIGN.md, section 4.4):
//  1. Seed: each camera alone (Zhang, "A flexible new technique for camera calibration", PAMI
//  2000), then the median pose of
//     the right camera against the left.
//  2. A robust solve by libmrcal, which marks outliers and finds photographs that do not fit.
//  3. The joint adjustment by Ceres, without regularisation: both cameras, the pose of the right
//  against the left, a board
//     pose a pair, and every point of the target, free about its nominal place with the prior 1 /
//     target_sigma. The image of a disc's centre is not the centroid of its image: the difference
//     is predicted and taken out.
//  4. The covariance of intrinsics and right_from_left with board poses and target marginalised
//  out, clustered by pair:
//     residuals of one photograph are correlated (the board flexes in the hand, light and focus
//     change). It is the delete-one-pair jackknife in its linear form (Bell and McCaffrey, Survey
//     Methodology 28, 2002, CR3), shrunk towards the model-based covariance where there are few
//     pairs.
//  5. Calibration modes: the board's overall scale is one of its own, since no residual can see it.
//
// Frames: rig = left camera. Units: mm, px, rad. Results do not depend on the number of threads.

// A length on the board that somebody measured, between two of its point ids.
struct KnownDistance {
  int first_id = 0;
  int second_id = 0;
  double distance_mm = 0;
  double sigma_mm = 0.02;
};

struct CalibrationOptions {
  // Empty: chosen by cross-validation between held-out pairs.
  std::optional<LensModel> model;
  bool rigid_target = false;  // trust the board: every point at its nominal place
  double target_sigma_mm =
      0.1;  // how far a point may lie from its nominal place; the default suits a printed sheet
  double scale_sigma = 1e-3;  // relative standard deviation of the board's overall scale; the
                              // default suits a printed sheet
  std::optional<KnownDistance>
      known_distance;         // sets the scale, and replaces scale_sigma by its own
  double outlier_sigmas = 5;  // points beyond are left out of the joint adjustment
  std::uint64_t seed = 1;
  bool compare_halves =
      true;  // also calibrate from even and from odd pairs, to report how far they agree

  // Throws UsageError naming the broken constraint.
  void Check() const;
};

struct CalibrationPair {
  std::string left_name, right_name;
  BoardDetection left, right;
};

// What became of one pair of photographs.
struct PairResult {
  std::string left_name, right_name;
  bool used = false;    // at least one of its photographs
  std::string problem;  // why the pair, or one of its photographs, was left out
  int left_points = 0, right_points = 0;
  int outliers = 0;
  double left_rms_px = 0, right_rms_px = 0;  // per component, of the points used
  Rigid3 left_from_board;
  double tilt_rad = 0;  // between the board's normal and the left camera's axis
};

// A residual of the final adjustment, for plots and tests.
struct CalibrationResidual {
  int pair = 0;
  int camera = 0;  // 0 left, 1 right
  int id = 0;
  Eigen::Vector2d pixel;
  Eigen::Vector2d residual_px;  // observed less predicted
  bool outlier = false;
};

// How far the halves of the data agree, in units of what the claimed covariance lets expect.
struct HalvesComparison {
  double baseline_difference_mm = 0,
         baseline_expected_mm = 0;  // expected: one sigma of the difference
  double angle_difference_rad = 0, angle_expected_rad = 0;
  double target_rms_difference_mm = 0;  // of the refined target points, per component; 0 when rigid
};

struct ModelScore {
  LensModel model;
  // Per component, over pairs that the fit did not see; infinite where the photographs do not
  // determine the model.
  double held_out_rms_px = 0;
  double held_out_sigma_px = 0;  // standard error of the difference to the best
};

struct Calibration {
  Calibration(BoardSpec board_spec, CalibrationOptions used_options, StereoRig stereo_rig)
      : board(std::move(board_spec)),
        options(std::move(used_options)),
        rig(std::move(stereo_rig)) {}

  BoardSpec board;
  CalibrationOptions options;
  StereoRig rig;  // with modes

  Eigen::MatrixXd
      covariance;  // (P, P) of StereoRig::Parameters, clustered by pair, without the scale
  Eigen::MatrixXd
      covariance_independent;  // the same if all residuals were independent: what others report
  double scale_sigma = 0;      // relative
  std::vector<Eigen::Vector3d> target_mm;  // refined board points by id, board frame
  std::vector<bool> target_seen;
  double target_rms_in_plane_mm = 0;  // departure from the nominal board, similarity taken out
  double target_rms_out_of_plane_mm = 0;

  double left_rms_px = 0, right_rms_px = 0, joint_rms_px = 0;  // per component
  double rigid_rms_px =
      0;  // joint, with the board at its nominal shape: the difference is the board's
  double fixed_to_board_share =
      0;  // share of the rigid residual's variance that is the same in every photograph
  int point_count = 0, outlier_count = 0;
  std::vector<PairResult> pairs;
  std::vector<CalibrationResidual> residuals;
  std::vector<ModelScore> model_scores;  // when the model was chosen automatically
  std::optional<HalvesComparison> halves;
  std::vector<std::string> warnings;  // plain sentences, most important first

  double working_distance_mm = 0;  // median distance of the board from the left camera
  double sigma_baseline_mm = 0, sigma_angle_rad = 0;  // without the scale
  double angle_rad = 0;                               // of right_from_left

  // The solve as mrcal understands it, for .cameramodel files: our result, with the target's
  // departures folded into the observations. Empty where the board is no regular grid.
  std::shared_ptr<const OptimizationInputs> optimization_inputs;
};

// Throws InputError when the photographs cannot give a calibration (too few pairs, all boards
// parallel, ...), saying what to do. `progress` is told what is being done, if given.
Calibration Calibrate(const BoardSpec& board, ImageSize left_size, ImageSize right_size,
                      const std::vector<CalibrationPair>& pairs,
                      const CalibrationOptions& options = {},
                      const std::function<void(const std::string&)>& progress = {});

}  // namespace plumbline
