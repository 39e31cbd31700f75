#include "track/patch_series.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "fit/carcass_thickness.h"

namespace plumbline {
namespace {

using Results = FramePatch::Results;

Results ResultsOf(const ContactPatch& patch) {
  Results results;
  results << patch.area_mm2, patch.length_mm, patch.width_mm, patch.centroid_mm;
  return results;
}

// A frame's images in a ground frame.
struct InGround {
  Image<Eigen::Vector3d> position_mm, undeformed_mm;
  const Image<double>* thickness_mm;

  InGround(const PatchFrame& frame, const Rigid3& ground_from_rig,
           const Image<Eigen::Vector3f>* along = nullptr)
      : position_mm(frame.point_mm),
        undeformed_mm(frame.undeformed_mm),
        thickness_mm(&frame.thickness_mm) {
    for (std::size_t i = 0; i < position_mm.pixel_count(); ++i) {
      const Eigen::Vector3d change = along == nullptr ? Eigen::Vector3d::Zero().eval()
                                                      : along->data()[i].cast<double>().eval();
      position_mm.data()[i] = ground_from_rig * (position_mm.data()[i] + change);
      undeformed_mm.data()[i] = ground_from_rig * (undeformed_mm.data()[i] + change);
    }
  }
  LiftOffFrame ForLiftOff() const { return {&position_mm, &undeformed_mm, thickness_mm}; }
};

class PatchOfFrame {
 public:
  PatchOfFrame(const PatchFrame& frame, const LiftOffLaw& law, const WheelAxis& axis,
               const PatchSeriesOptions& options)
      : frame_(frame), law_(law), axis_(axis), options_(options) {}

  // By the law; sigmas and all. Says why not.
  bool Find(FramePatch* record) const {
    const InGround ground(frame_, frame_.rotation.ground.frame_from_rig);
    const auto line = Line(ground, &record->problem);
    if (!line) return false;
    const auto patch = PatchWithin(ground.ForLiftOff(), *line);
    if (!patch) {
      record->problem = "no point is in contact by the law of lift-off";
      return false;
    }
    record->by = FramePatch::By::kLiftOff;
    record->patch = *patch;
    const Results results = ResultsOf(*patch);

    // d results / d a0..a4, by differences.
    Eigen::Matrix<double, ContactPatch::kResults, LiftOffLine::kTerms> J;
    constexpr double kStep_mm = 0.02;
    for (int k = 0; k < LiftOffLine::kTerms; ++k) {
      LiftOffLine more = *line, less = *line;
      more.a[k] += kStep_mm;
      less.a[k] -= kStep_mm;
      const auto larger = PatchWithin(ground.ForLiftOff(), more);
      const auto smaller = PatchWithin(ground.ForLiftOff(), less);
      if (!larger || !smaller) return false;
      J.col(k) = (ResultsOf(*larger) - ResultsOf(*smaller)) / (2 * kStep_mm);
    }
    const auto by_law = (J * line->d_a_d_law).eval();
    const Results law = (by_law * law_.cov * by_law.transpose()).diagonal();
    Results variance = (J * line->cov * J.transpose()).diagonal() + law;
    variance += OfGround(results);
    record->sigma_law = law.cwiseMax(0).cwiseSqrt();
    record->sigma_random = variance.cwiseMax(0).cwiseSqrt();
    Results common = Results::Zero();
    const std::size_t modes = frame_.along_modes_mm.size();
    for (std::size_t m = 0; m < modes; ++m) {
      InGround along(frame_, frame_.rotation.ground.along_modes[m], &frame_.along_modes_mm[m]);
      along.thickness_mm =
          &ThicknessAlong(m, modes, frame_.thickness_mm, frame_.thickness_along_modes);
      common += (Again(along).value_or(results) - results).cwiseAbs2();
    }
    record->sigma_calibration = common.cwiseSqrt();
    return true;
  }

 private:
  std::optional<LiftOffLine> Line(const InGround& ground, std::string* why = nullptr) const {
    return FindLiftOffLine(ground.ForLiftOff(), law_, options_.sigma_mm,
                           options_.correlation_area_points, options_.lift_off, why);
  }

  std::optional<Results> Again(const InGround& ground) const {
    const auto line = Line(ground);
    if (!line) return std::nullopt;
    const auto patch = PatchWithin(ground.ForLiftOff(), *line);
    if (!patch) return std::nullopt;
    return ResultsOf(*patch);
  }

  // The variance that the ground's own pose brings, by a step along each axis of its covariance.
  Results OfGround(const Results& results) const {
    const RigRotationFrame& rotation = frame_.rotation;
    const Eigen::Matrix3d root = Eigen::LLT<Eigen::Matrix3d>(rotation.cov_random).matrixL();
    const Rigid3 back = GroundOf(rotation.pose, axis_).Inverse();
    Results variance = Results::Zero();
    for (int k = 0; k < 3; ++k) {
      if (!root.col(k).allFinite()) continue;
      const Rigid3 change = GroundOf(rotation.pose + root.col(k), axis_) * back;
      const InGround moved(frame_, change * rotation.ground.frame_from_rig);
      variance += (Again(moved).value_or(results) - results).cwiseAbs2();
    }
    return variance;
  }

  const PatchFrame& frame_;
  const LiftOffLaw& law_;
  const WheelAxis& axis_;
  const PatchSeriesOptions& options_;
};

std::optional<LiftOffLaw> LawOf(std::span<const PatchFrame> frames,
                                const PatchSeriesOptions& options, std::string* why) {
  if (options.law) return options.law;
  std::vector<InGround> ground;
  std::vector<LiftOffFrame> all;
  for (const PatchFrame& frame : frames) {
    if (frame.rotation.from != RigRotationFrame::From::kPlane || !frame.rotation.found) continue;
    ground.emplace_back(frame, frame.rotation.ground.frame_from_rig);
  }
  for (const InGround& frame : ground) all.push_back(frame.ForLiftOff());
  try {
    return FitLiftOffLaw(all, options.sigma_mm, options.correlation_area_points, options.lift_off);
  } catch (const InputError& error) {
    *why = error.what();
    return std::nullopt;
  }
}

// A boundary far inside of what lies within the threshold is none of a tyre that lifts off from
// flat ground: there the one is three quarters of the other.
bool Holds(FramePatch* record) {
  constexpr double kLeastShare = 0.55;
  if (!record->within_threshold ||
      record->patch.area_mm2 > kLeastShare * record->within_threshold->area_mm2) {
    return true;
  }
  record->problem =
      "the law of lift-off does not hold: by it little touches of what lies within the threshold";
  return false;
}

// How large what the law leaves out may be, before anything is measured: as large as on the virtual
// tyre at most (docs/theory.md).
Results LikelyModelErrors(const Results& results) {
  Results likely;
  likely << 0.008 * results[0], 0.0035 * results[1], 0.0035 * results[2],
      0.0005 * results[1] * Eigen::Vector2d::Ones();
  return likely;
}

// What the law leaves out: its next term. That takes errors in proportion to the square of the
// distance in the law up to which it is fitted, the fourth root of the gap squared: fitted up to
// half the gap, results are nearer to the truth by 1 - sqrt(1/2) of their error. In the mean over
// the frames, for single ones are noisy; and where the noise of the two laws (of which the one has
// less than the other's points) hides it, as much of what is likely as is not known better.
void AddModelErrors(std::span<const PatchFrame> frames, const WheelAxis& axis,
                    PatchSeriesOptions options, PatchSeries* series) {
  options.lift_off.largest_gap_mm /= 2;
  const double nearer = 1 - std::sqrt(0.5);
  std::string why;
  const std::optional<LiftOffLaw> law = LawOf(frames, options, &why);
  if (!law) return;
  Results sum = Results::Zero(), noise = Results::Zero();
  int count = 0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const FramePatch& record = series->frames[f];
    if (record.by != FramePatch::By::kLiftOff) continue;
    FramePatch again;
    if (!PatchOfFrame(frames[f], *law, axis, options).Find(&again)) continue;
    sum += ResultsOf(again.patch) - ResultsOf(record.patch);
    noise += again.sigma_law.cwiseAbs2() - record.sigma_law.cwiseAbs2();
    ++count;
  }
  if (count == 0) return;
  const Results told = sum / (count * nearer);
  const Results variance = (noise / (count * nearer * nearer)).cwiseMax(0);
  for (FramePatch& record : series->frames) {
    if (record.by != FramePatch::By::kLiftOff) continue;
    // The mean square of the error, given what is told of it and what was likely.
    const Results likely = LikelyModelErrors(ResultsOf(record.patch)).cwiseAbs2();
    const Results share = likely.cwiseQuotient(likely + variance);
    const Results model = share.cwiseProduct(told).cwiseAbs2() + share.cwiseProduct(variance);
    record.sigma_law = (record.sigma_law.cwiseAbs2() + model).cwiseSqrt();
    record.sigma_random = (record.sigma_random.cwiseAbs2() + model).cwiseSqrt();
  }
}

}  // namespace

void PatchSeriesOptions::Check() const {
  lift_off.Check();
  threshold.Check();
  if (!(sigma_mm > 0)) throw UsageError("The sigma of the points must be positive.");
  if (!(correlation_area_points >= 1)) {
    throw UsageError("At least one point shares a point's noise: its own.");
  }
}

PatchSeries FindPatches(std::span<const PatchFrame> frames, const WheelAxis& axis,
                        const PatchSeriesOptions& options) {
  options.Check();
  for (const PatchFrame& frame : frames) {
    if (!frame.along_modes_mm.empty() && frame.rotation.found &&
        frame.along_modes_mm.size() != frame.rotation.ground.along_modes.size()) {
      throw std::invalid_argument("FindPatches: points and ground with different modes");
    }
  }
  PatchSeries series;
  std::string no_law;
  series.law = LawOf(frames, options, &no_law);
  for (const PatchFrame& frame : frames) {
    FramePatch& record = series.frames.emplace_back();
    if (!frame.rotation.found) {
      record.problem = frame.rotation.problem;
      continue;
    }
    const InGround ground(frame, frame.rotation.ground.frame_from_rig);
    std::string why;
    record.within_threshold =
        FindContactPatch(ground.position_mm, frame.thickness_mm, options.threshold, &why);
    record.problem = no_law;
    if (series.law && PatchOfFrame(frame, *series.law, axis, options).Find(&record) &&
        Holds(&record)) {
      continue;
    }
    if (!record.within_threshold) {
      record.problem = why;
      continue;
    }
    record.by = FramePatch::By::kThreshold;
    record.patch = *record.within_threshold;
    record.sigma_random.setConstant(std::numeric_limits<double>::quiet_NaN());
    record.sigma_calibration = record.sigma_law = record.sigma_random;
  }
  if (series.law && !options.law) AddModelErrors(frames, axis, options, &series);
  return series;
}

}  // namespace plumbline
