#include "apps/internal/rig_watch.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <string>

#include "calib/error.h"
#include "calib/median.h"

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

// Distances from the epipolar lines, px of the right image.
struct Epipolar {
  double mean_px = 0, rms_px = 0, expected_px = 0;
};

// Mismatches, far outside of the scatter about the median, are left out.
Epipolar EpipolarOf(const StereoRig& rig, std::span<const StereoObservation> observations) {
  std::vector<TriangulatedPoint> points = Triangulate(rig, observations);
  std::erase_if(points, [](const TriangulatedPoint& p) { return !std::isfinite(p.epipolar_px); });
  if (points.empty()) return {};
  std::vector<double> values;
  for (const TriangulatedPoint& point : points) values.push_back(point.epipolar_px);
  const double middle = Median(values);
  for (double& value : values) value = std::abs(value - middle);
  constexpr double kFarOff = 8;  // median deviations: 5.4 sigmas of normal scatter
  const double limit = kFarOff * Median(values);
  Epipolar out;
  double n = 0;
  for (const TriangulatedPoint& point : points) {
    if (std::abs(point.epipolar_px - middle) > limit) continue;
    out.mean_px += point.epipolar_px;
    out.rms_px += point.epipolar_px * point.epipolar_px;
    out.expected_px += point.sigma_epipolar_px * point.sigma_epipolar_px;
    n += 1;
  }
  out.mean_px /= n;
  out.rms_px = std::sqrt(out.rms_px / n);
  out.expected_px = std::sqrt(out.expected_px / n);
  return out;
}

// Where the matches scatter by more than they claim, so does the pose.
double Believed(double chi2, const RelativePose& pose) {
  return chi2 / std::max(1.0, pose.sigma0 * pose.sigma0);
}

// By how much a motion takes points from their epipolar lines, from the rms with it and without.
double TakenBy(double with_px, double without_px) {
  return std::sqrt(std::max(0.0, with_px * with_px - without_px * without_px));
}

RigWatchRecord RecordOf(const RelativePose& pose, const Epipolar& epipolar) {
  RigWatchRecord record;
  record.found = true;
  record.epipolar_mean_px = epipolar.mean_px;
  record.epipolar_rms_px = epipolar.rms_px;
  record.epipolar_sigma_px = epipolar.expected_px;
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

RigWatch::Verdict RigWatch::Reference(std::span<const StereoObservation> observations) {
  Verdict verdict{{}, rig_, {}};
  try {
    first_ = RefineRelativePose(rig_, observations);
    verdict.record = RecordOf(*first_, EpipolarOf(rig_, observations));
    verdict.record.chi2_first = 0;
    verdict.record.alarm =
        Moved(first_->chi2, TakenBy(first_->epipolar_rms_before_px, first_->epipolar_rms_after_px));
    if (options_.refinement != PoseRefinement::kOff && verdict.record.alarm) {
      verdict.record.refined = true;
      verdict.rig.right_from_left = WithBaseline(first_->right_from_left);
      base_errors_ = ErrorsOf(first_->cov_random, rig_.baseline_mm());
      for (const Vector6& error : base_errors_) {
        verdict.right_from_left_moved.push_back(
            internal::Moved(error, verdict.rig.right_from_left));
      }
      verdict.right_from_left_moved.resize(kPoseModes, verdict.rig.right_from_left);
    }
  } catch (const InputError& error) {
    verdict.record.problem = error.what();
  }
  base_ = verdict.rig;
  verdict.record.right_from_left = verdict.rig.right_from_left;
  return verdict;
}

RigWatch::Verdict RigWatch::Later(std::span<const StereoObservation> observations) const {
  Verdict verdict{{}, base_, {}};
  try {
    if (!first_) throw InputError("the reference pair does not tell the pose of the cameras");
    const RelativePose now = RefineRelativePose(rig_, observations);
    const PoseChange since = Between(*first_, now);
    verdict.record = RecordOf(now, EpipolarOf(rig_, observations));
    verdict.record.chi2_first = since.chi2;
    StereoRig as_before = rig_;
    as_before.right_from_left = first_->right_from_left;
    const double by_px =
        TakenBy(EpipolarOf(as_before, observations).rms_px, now.epipolar_rms_after_px);
    verdict.record.alarm = Moved(Believed(since.chi2, now), by_px);
    const bool refine =
        options_.refinement == PoseRefinement::kAlways ||
        (options_.refinement == PoseRefinement::kWhenSignificant && verdict.record.alarm);
    verdict.record.refined = refine || !base_errors_.empty();
    const Vector6 change = refine ? since.change : Vector6::Zero().eval();
    verdict.rig.right_from_left = WithBaseline(internal::Moved(change, base_.right_from_left));
    for (const Vector6& error : base_errors_) {
      verdict.right_from_left_moved.push_back(
          internal::Moved(change, internal::Moved(error, base_.right_from_left)));
    }
    if (!refine) {
      if (!base_errors_.empty()) {
        verdict.right_from_left_moved.resize(kPoseModes, verdict.rig.right_from_left);
      }
    } else {
      verdict.right_from_left_moved.resize(kPoseModes / 2, verdict.rig.right_from_left);
      for (const Vector6& error : ErrorsOf(since.cov_random, rig_.baseline_mm())) {
        verdict.right_from_left_moved.push_back(
            internal::Moved(error, verdict.rig.right_from_left));
      }
    }
  } catch (const InputError& error) {
    verdict.record.problem = error.what();
  }
  verdict.record.right_from_left = verdict.rig.right_from_left;
  return verdict;
}

}  // namespace plumbline::internal
