#include "apps/internal/rig_watch.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

Rigid3 Moved(const Vector6& change, const Rigid3& pose) {
  return Rigid3::FromRotationVector(change.head<3>(), change.tail<3>()) * pose;
}

// One standard deviation of a motion along each of its five independent directions.
std::vector<Vector6> ErrorsOf(const Matrix6& cov, double baseline_mm) {
  // In the units of the scatter of a point: rotations count by what they do to the baseline.
  Vector6 unit;
  unit << Eigen::Vector3d::Constant(baseline_mm), Eigen::Vector3d::Ones();
  const Eigen::SelfAdjointEigenSolver<Matrix6> parts(unit.asDiagonal() * cov * unit.asDiagonal());
  std::vector<Vector6> errors;
  for (int place = 5; place > 0; --place) {  // the largest first; the last is the baseline's length
    errors.emplace_back(std::sqrt(std::max(0.0, parts.eigenvalues()[place])) *
                        parts.eigenvectors().col(place).cwiseQuotient(unit));
  }
  return errors;
}

// other: see RelativePoseOptions.
RelativePoseOptions PoseOptions(const std::optional<Rigid3>& other) {
  RelativePoseOptions options;
  options.scale_by_scatter = true;
  options.other_pose = other;
  return options;
}

// By how much a motion takes points from their epipolar lines, from the rms with it and without.
double TakenBy(double with_px, double without_px) {
  return std::sqrt(std::max(0.0, with_px * with_px - without_px * without_px));
}

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

bool RigWatch::Moved(double chi2, double by_px) const {
  return chi2 > options_.alarm_chi2 && by_px > options_.alarm_epipolar_px;
}

// The length of the baseline is that of the calibration.
Rigid3 RigWatch::WithBaseline(Rigid3 pose) const {
  pose.translation_mm *= rig_.baseline_mm() / pose.translation_mm.norm();
  return pose;
}

// `change`: of the pose since the reference pair, with errors of its own.
void RigWatch::SetPose(const Vector6& change, const std::vector<Vector6>& errors,
                       Verdict& verdict) const {
  const Rigid3 pose = WithBaseline(internal::Moved(change, base_.right_from_left));
  verdict.rig.right_from_left = pose;
  if (base_errors_.empty() && errors.empty()) return;
  std::vector<Rigid3>& moved = verdict.right_from_left_moved;
  for (const Vector6& error : base_errors_) {
    moved.push_back(internal::Moved(change, internal::Moved(error, base_.right_from_left)));
  }
  moved.resize(kPoseModes / 2, pose);
  for (const Vector6& error : errors) moved.push_back(internal::Moved(error, pose));
  moved.resize(kPoseModes, pose);
}

RigWatch::Verdict RigWatch::Reference(std::span<const StereoObservation> observations) {
  Verdict verdict{{}, rig_, {}};
  try {
    first_ = RefineRelativePose(rig_, observations, PoseOptions({}));
    verdict.record = RecordOf(*first_);
    verdict.record.chi2_first = 0;
    verdict.record.alarm =
        Moved(first_->chi2, TakenBy(first_->epipolar_rms_before_px, first_->epipolar_rms_after_px));
    if (options_.refinement != PoseRefinement::kOff && verdict.record.alarm) {
      verdict.record.refined = true;
      base_.right_from_left = WithBaseline(first_->right_from_left);
      base_errors_ = ErrorsOf(first_->cov_random, rig_.baseline_mm());
      SetPose(Vector6::Zero(), {}, verdict);
    }
  } catch (const InputError& error) {
    verdict.record.problem = error.what();
  }
  verdict.record.right_from_left = verdict.rig.right_from_left;
  return verdict;
}

RigWatch::Verdict RigWatch::Later(std::span<const StereoObservation> observations) const {
  Verdict verdict{{}, base_, {}};
  try {
    if (!first_) throw InputError("the reference pair does not tell the pose of the cameras");
    const RelativePose now =
        RefineRelativePose(rig_, observations, PoseOptions(first_->right_from_left));
    const PoseChange since = Between(*first_, now);
    verdict.record = RecordOf(now);
    verdict.record.chi2_first = since.chi2;
    verdict.record.alarm =
        Moved(since.chi2, TakenBy(now.epipolar_rms_other_px, now.epipolar_rms_after_px));
    const bool refine =
        options_.refinement == PoseRefinement::kAlways ||
        (options_.refinement == PoseRefinement::kWhenSignificant && verdict.record.alarm);
    verdict.record.refined = refine || !base_errors_.empty();
    if (refine) {
      SetPose(since.change, ErrorsOf(since.cov_random, rig_.baseline_mm()), verdict);
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
