#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/internal/field_options.h"
#include "apps/internal/option_table.h"
#include "apps/internal/strain_options.h"
#include "apps/stereo_run.h"
#include "apps/surface_evaluation.h"

namespace plumbline::internal {

// What can be worked out again of matches that are there: the options that `measure --matcher dic`
// and `analyse` of a stereo run have in common.
class EvaluationOptionSet {
 public:
  // of: StrainOptionSet::Of::kEither where the command takes planar runs too.
  void Declare(OptionTable& options, StrainOptionSet::Of of = StrainOptionSet::Of::kSurface);
  // rolling_tyre: see StrainOptionSet. Throws UsageError.
  SurfaceEvaluationOptions Options(std::uint64_t seed, bool rolling_tyre = false) const;

  // The options of the plane, and whether positions are told in its frame, are declared apart:
  // measure has them for all matchers.
  void DeclareGround(OptionTable& options);
  const GroundPlaneOptions& ground() const { return ground_; }
  bool in_ground_frame() const { return frame_ == "ground"; }
  bool point_covariance() const { return point_covariance_; }
  bool remove_rigid_motion() const { return remove_rigid_motion_; }
  const StrainOptionSet& strain() const { return strain_; }

 private:
  GroundPlaneOptions ground_;
  std::string frame_ = "ground";
  bool point_covariance_ = false;
  EpipolarOptions epipolar_;
  StrainOptionSet strain_;
  bool no_strain_ = false, remove_rigid_motion_ = false;
  std::string strain_axes_ = "material", refine_pose_ = "off";
};

// The matching of stereo-DIC.
class StereoOptionSet {
 public:
  // noise_file: as FieldOptionSet's.
  void Declare(OptionTable& options, bool noise_file = true);

  // `bits`: of the images, for the noise. Region and mask are left to the caller. Throws
  // UsageError; InputError where the noise file cannot be read.
  StereoRunOptions Options(std::uint64_t seed, int bits, int step_px,
                           const SurfaceEvaluationOptions& evaluation) const;

  StereoStrategy strategy() const;
  bool order_given() const { return matching_.order_given(); }
  bool stores_matches() const { return !no_matches_; }
  int block_frames() const { return block_frames_; }
  const std::string& noise() const { return matching_.noise(); }

 private:
  FieldOptionSet matching_;
  std::string strategy_ = "reference";
  StereoSequenceOptions sequence_;
  bool no_curvature_ = false, no_matches_ = false;
  int block_frames_ = 32;
};

}  // namespace plumbline::internal
