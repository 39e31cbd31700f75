#include "apps/internal/rig_watch.h"

#include "calib/error.h"

namespace plumbline::internal {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;

RigWatchRecord RecordOf(const RelativePose& pose) {
  RigWatchRecord record;
  record.found = true;
  record.epipolar_mean_px = pose.epipolar_mean_before_px;
  record.epipolar_rms_px = pose.epipolar_rms_before_px;
  record.epipolar_sigma_px = pose.epipolar_sigma_px;
  record.chi2_calibration = pose.chi2;
  record.change = pose.change;
  record.sigma_random_change = pose.cov_random.diagonal().cwiseMax(0).cwiseSqrt();
  record.sigma_calibration_change = pose.cov_calibration.diagonal().cwiseMax(0).cwiseSqrt();
  return record;
}

}  // namespace

// `change`: of the pose since the reference pair, with errors of its own.
void RigWatch::SetPose(const Vector6& change, const std::vector<Vector6>& errors,
                       Verdict& verdict) const {
  const Rigid3 pose = WithBaselineOf(rig_, PoseAfter(change, base_.right_from_left));
  verdict.rig.right_from_left = pose;
  if (base_errors_.empty() && errors.empty()) return;
  std::vector<Rigid3>& moved = verdict.right_from_left_moved;
  for (const Vector6& error : base_errors_) {
    moved.push_back(PoseAfter(change, PoseAfter(error, base_.right_from_left)));
  }
  moved.resize(kPoseModes / 2, pose);
  for (const Vector6& error : errors) moved.push_back(PoseAfter(error, pose));
  moved.resize(kPoseModes, pose);
}

RigWatch::Verdict RigWatch::Reference(std::span<const StereoObservation> observations) {
  Verdict verdict{{}, rig_, {}};
  try {
    first_ = PoseOfPair(rig_, observations, options_.alike_points);
    verdict.record = RecordOf(*first_);
    verdict.record.chi2_first = 0;
    verdict.record.alarm = options_.limits.Beyond(first_->chi2, first_->epipolar_rms_before_px,
                                                  first_->epipolar_rms_after_px);
    if (options_.refinement != PoseRefinement::kOff && verdict.record.alarm) {
      verdict.record.refined = true;
      base_.right_from_left = WithBaselineOf(rig_, first_->right_from_left);
      base_errors_ = ErrorsOfMotion(first_->cov_random, rig_.baseline_mm());
      SetPose(Vector6::Zero(), {}, verdict);
    }
  } catch (const InputError& error) {
    verdict.record.problem = error.what();
  }
  verdict.record.right_from_left = verdict.rig.right_from_left;
  return verdict;
}

RigWatch::Verdict RigWatch::Later(std::span<const StereoObservation> observations,
                                  std::span<const Eigen::Vector2d> right_common_px) const {
  Verdict verdict{{}, base_, {}};
  try {
    if (!first_) throw InputError("the reference pair does not tell the pose of the cameras");
    const CameraMotion motion = MotionSince(rig_, *first_, observations, options_.alike_points,
                                            options_.limits, right_common_px);
    const PoseChange& since = motion.since;
    verdict.record = RecordOf(motion.pose);
    verdict.record.chi2_first = since.chi2;
    verdict.record.alarm = motion.moved;
    const bool refine =
        options_.refinement == PoseRefinement::kAlways ||
        (options_.refinement == PoseRefinement::kWhenSignificant && verdict.record.alarm);
    verdict.record.refined = refine || !base_errors_.empty();
    if (refine) {
      SetPose(since.change, ErrorsOfMotion(since.cov_random, rig_.baseline_mm()), verdict);
    } else {
      SetPose(Vector6::Zero(), {}, verdict);
    }
  } catch (const InputError& error) {
    verdict.record.problem = error.what();
    verdict.record.refined = !base_errors_.empty();
    SetPose(Vector6::Zero(), {}, verdict);
  }
  verdict.record.right_from_left = verdict.rig.right_from_left;
  return verdict;
}

}  // namespace plumbline::internal
