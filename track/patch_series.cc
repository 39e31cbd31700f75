#include "track/patch_series.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <stdexcept>

#include "calib/error.h"
#include "track/carcass_estimate.h"
#include "track/internal/patch_in_ground.h"

namespace plumbline {
namespace {

using Results = FramePatch::Results;

using internal::InGround;

// The law, and how it goes along each of the carcass's modes, behind those of the calibration.
struct LawOfRun {
  LiftOffLaw law;
  std::vector<LiftOffLaw::Parameters> along_carcass = {};

  LiftOffLaw Along(const LiftOffLaw::Parameters& change) const {
    LiftOffLaw there = law;
    there.log_k += change[0];
    there.m += change[1];
    there.n += change[2];
    return there;
  }
};

// A way to a patch: its results, from a frame as it lies in a ground frame and what a mode does to
// the law. Nothing where there is none.
using Way =
    std::function<std::optional<Results>(const InGround&, const LiftOffLaw::Parameters& of_law)>;

// What errors that are common to all points of a frame do to its results: another way of looking at
// the same frame, less `results`. NaN where that has no patch.
class CommonErrors {
 public:
  CommonErrors(const PatchFrame& frame, const WheelAxis& axis, const Results& results,
               const Way& way)
      : frame_(frame), axis_(axis), results_(results), way_(way) {}

  // The variance that the ground's own pose brings, by a step along each axis of its covariance,
  // and the pose of the cameras.
  Results Random() const {
    const RigRotationFrame& rotation = frame_.rotation;
    const Eigen::Matrix3d root = Eigen::LLT<Eigen::Matrix3d>(rotation.cov_random).matrixL();
    const Rigid3 back = GroundOf(rotation.pose, axis_).Inverse();
    Results variance = Results::Zero();
    for (int k = 0; k < 3; ++k) {
      if (!root.col(k).allFinite() || root.col(k).isZero(0)) continue;
      const Rigid3 change = GroundOf(rotation.pose + root.col(k), axis_) * back;
      variance += SquareOf(InGround(frame_, change * rotation.ground.frame_from_rig));
    }
    for (const Image<Eigen::Vector3f>& along : frame_.along_pose_mm) {
      variance += SquareOf(InGround(frame_, rotation.ground.frame_from_rig, &along));
    }
    return variance;
  }

  // The calibration's, along each mode points, ground and thickness together, and along those of
  // the carcass the law.
  Results Calibration(std::span<const LiftOffLaw::Parameters> law_along_carcass) const {
    Results variance = Results::Zero();
    const std::size_t modes = frame_.along_modes_mm.size();
    const std::size_t others = modes - law_along_carcass.size();
    for (std::size_t m = 0; m < modes; ++m) {
      InGround along(frame_, frame_.rotation.ground.along_modes[m], &frame_.along_modes_mm[m]);
      along.thickness_mm =
          &ThicknessAlong(m, modes, frame_.thickness_mm, frame_.thickness_along_modes);
      variance += SquareOf(along, m < others ? kNoChange : law_along_carcass[m - others]);
    }
    return variance;
  }

 private:
  Results SquareOf(const InGround& there, const LiftOffLaw::Parameters& of_law = kNoChange) const {
    const std::optional<Results> results = way_(there, of_law);
    if (!results) return Results::Constant(std::numeric_limits<double>::quiet_NaN());
    return (*results - results_).cwiseAbs2();
  }

  inline static const LiftOffLaw::Parameters kNoChange = LiftOffLaw::Parameters::Zero();
  const PatchFrame& frame_;
  const WheelAxis& axis_;
  const Results& results_;
  const Way& way_;
};

Results RootOf(const Results& variance) { return variance.cwiseMax(0).cwiseSqrt(); }

class PatchOfFrame {
 public:
  PatchOfFrame(const PatchFrame& frame, const WheelAxis& axis, const PatchSeriesOptions& options)
      : frame_(frame),
        axis_(axis),
        options_(options),
        ground_(frame, frame.rotation.ground.frame_from_rig) {}

  // By the law; sigmas and all. Says why not.
  bool FindByLaw(const LawOfRun& of_run, FramePatch* record) const {
    const LiftOffLaw& law = of_run.law;
    const auto line = Line(ground_, law, &record->problem);
    if (!line) return false;
    const auto patch = PatchWithin(ground_.ForLiftOff(), *line);
    if (!patch) {
      record->problem = "no point is in contact by the law of lift-off";
      return false;
    }
    record->patch = *patch;

    // d results / d a0..a4, by differences.
    Eigen::Matrix<double, ContactPatch::kResults, LiftOffLine::kTerms> J;
    constexpr double kStep_mm = 0.02;
    for (int k = 0; k < LiftOffLine::kTerms; ++k) {
      LiftOffLine more = *line, less = *line;
      more.a[k] += kStep_mm;
      less.a[k] -= kStep_mm;
      const auto larger = PatchWithin(ground_.ForLiftOff(), more);
      const auto smaller = PatchWithin(ground_.ForLiftOff(), less);
      if (!larger || !smaller) return false;
      J.col(k) = (larger->results() - smaller->results()) / (2 * kStep_mm);
    }
    const auto by_law = (J * line->d_a_d_law).eval();
    const Results of_law = (by_law * law.cov * by_law.transpose()).diagonal() +
                           LeftOut(J.col(0), J.col(kEllipse), patch->area_mm2);
    record->by = FramePatch::By::kLiftOff;
    record->sigma_law = RootOf(of_law);
    AddCommon(
        (J * line->cov * J.transpose()).diagonal() + of_law,
        [&](const InGround& there, const LiftOffLaw::Parameters& change) -> std::optional<Results> {
          const auto again = Line(there, of_run.Along(change));
          // A law that is held may not bear the error of a thickness: not counted.
          if (!again) return patch->results();
          return ResultsOf(PatchWithin(there.ForLiftOff(), *again)).value_or(patch->results());
        },
        of_run.along_carcass, record);
    return true;
  }

  // Within the threshold, sigmas and all, where there is such a patch.
  void FindWithinThreshold(const NeighbourCorrelation& neighbours, FramePatch* record) const {
    if (!record->within_threshold) return;
    record->by = FramePatch::By::kThreshold;
    record->patch = *record->within_threshold;
    record->sigma_law.setZero();
    AddCommon(
        OfPoints(record->patch, neighbours),
        [&](const InGround& there, const LiftOffLaw::Parameters&) {
          return ResultsOf(WithinThreshold(there));
        },
        {}, record);
  }

  std::optional<ContactPatch> WithinThreshold(std::string* why) const {
    return WithinThreshold(ground_, why);
  }

 private:
  static constexpr int kEllipse = 3;  // the place of x^2 - y^2 among the terms

  // What the law leaves out, as an error of the depth at which the tyre leaves the ground: all
  // round, and along against across, where the boundary is about a circle. d results by the two.
  Results LeftOut(const Results& by_all, const Results& by_ellipse, double area_mm2) const {
    const double round = area_mm2 / std::numbers::pi / std::pow(LiftOffLine::kLength_mm, 2);
    return std::pow(options_.sigma_depth_mm, 2) * by_all.cwiseAbs2() +
           std::pow(options_.sigma_ellipse_mm / round, 2) * by_ellipse.cwiseAbs2();
  }

  static std::optional<Results> ResultsOf(const std::optional<ContactPatch>& patch) {
    if (!patch) return std::nullopt;
    return patch->results();
  }

  std::optional<ContactPatch> WithinThreshold(const InGround& ground,
                                              std::string* why = nullptr) const {
    return FindContactPatch(ground.position_mm, *ground.thickness_mm, options_.threshold, why);
  }

  std::optional<LiftOffLine> Line(const InGround& ground, const LiftOffLaw& law,
                                  std::string* why = nullptr) const {
    return FindLiftOffLine(ground.ForLiftOff(), law, options_.sigma_mm,
                           options_.correlation_area_points, options_.lift_off, why);
  }

  void AddCommon(const Results& variance, const Way& way,
                 std::span<const LiftOffLaw::Parameters> law_along_carcass,
                 FramePatch* record) const {
    const Results results = record->patch.results();
    const CommonErrors common(frame_, axis_, results, way);
    record->sigma_random = RootOf(variance + common.Random());
    record->sigma_calibration = RootOf(common.Calibration(law_along_carcass));
  }

  // The variance that the noise of single points brings, and the square of what it adds to the
  // length of blunt ends.
  Results OfPoints(const ContactPatch& patch, const NeighbourCorrelation& neighbours) const {
    const Eigen::Matrix3d turn = frame_.rotation.ground.frame_from_rig.rotation;
    const auto columns = static_cast<std::size_t>(frame_.point_mm.width());
    const auto row = [&](std::size_t place) { return static_cast<int>(place / columns); };
    const auto column = [&](std::size_t place) { return static_cast<int>(place % columns); };
    Results variance =
        patch
            .CovarianceOf(
                [&](std::size_t place) {
                  return Eigen::Matrix3d(turn * frame_.cov_mm2.data()[place] * turn.transpose());
                },
                [&](std::size_t a, std::size_t b) -> double {
                  const int dr = row(b) - row(a), dc = column(b) - column(a);
                  if (std::max(std::abs(dr), std::abs(dc)) > neighbours.reach()) return 0;
                  return neighbours.Between(row(a), column(a), dr, dc).trace() / 2;
                })
            .diagonal();
    for (const int axis : {0, 1}) {
      const double more = BluntEnds(patch, axis, variance[1 + axis]);
      const double extent_mm = axis == 0 ? patch.length_mm : patch.width_mm;
      variance[1 + axis] += more;
      variance[5] += std::pow(patch.shape_factor / extent_mm, 2) * more;
    }
    return variance;
  }

  // The outermost of m corners with independent noise s is off by s^2 (1 + 0.31 ln(m)^2) in the
  // mean square (normal, m from 3 to 20, within 5 %). variance: of the extent, from both ends.
  // Returns what is to be added.
  double BluntEnds(const ContactPatch& patch, int axis, double variance) const {
    const double sigma_mm = std::sqrt(variance / 2);
    double low = std::numeric_limits<double>::max(), high = -low;
    for (const Polygon& contour : patch.contours_mm) {
      for (const Eigen::Vector2d& corner : contour) {
        low = std::min(low, corner[axis]);
        high = std::max(high, corner[axis]);
      }
    }
    double at_low = 0, at_high = 0;
    for (const Polygon& contour : patch.contours_mm) {
      for (const Eigen::Vector2d& corner : contour) {
        if (corner[axis] < low + 3 * sigma_mm) ++at_low;
        if (corner[axis] > high - 3 * sigma_mm) ++at_high;
      }
    }
    const auto of = [](double corners) { return 0.31 * std::pow(std::log(corners), 2); };
    return (of(at_low) + of(at_high)) * variance / 2;
  }

  const PatchFrame& frame_;
  const WheelAxis& axis_;
  const PatchSeriesOptions& options_;
  InGround ground_;
};

// The law under which a map of the carcass that may be wrong is as it is, and how it goes with it.
LawOfRun LawByThickness(const LawAndThickness& fitted, const CarcassThickness& carcass) {
  LawOfRun of_run{fitted.law};
  const auto change = [&](const Eigen::VectorXd& added_mm) {
    return LiftOffLaw::Parameters(fitted.d_law_d_thickness * added_mm);
  };
  of_run.law = of_run.Along(change(-fitted.added_mm));
  for (int k = 0; k < carcass.mode_count(); ++k) {
    of_run.along_carcass.push_back(change(carcass.OfMode(k)));
  }
  return of_run;
}

std::optional<LawOfRun> LawOf(std::span<const PatchFrame> frames, const WheelAxis& axis,
                              const PatchSeriesOptions& options, std::string* why) {
  if (options.law) return LawOfRun{*options.law};
  const internal::FramesOnGround ground(frames, axis, options.carcass);
  const double area = options.correlation_area_points;
  if (options.carcass.uncertain_map()) {
    try {
      const ThicknessPrior prior = PriorOf(options.carcass);
      const LawAndThickness fitted =
          FitLawAndThickness(ground.ForLiftOff(), options.sigma_mm, area, &prior, options.lift_off);
      const LawOfRun of_run = LawByThickness(fitted, options.carcass);
      if (ground.Holds(of_run.law, options)) return of_run;
    } catch (const InputError&) {
      // No frame tells the thickness; it is held.
    }
  }
  try {
    return LawOfRun{FitLiftOffLaw(ground.ForLiftOff(), options.sigma_mm, area, options.lift_off)};
  } catch (const InputError& error) {
    *why = error.what();
    return std::nullopt;
  }
}

// A boundary far inside of what lies within the threshold is none of a tyre that lifts off from
// flat ground: there the one is three quarters of the other.
bool Holds(FramePatch* record) {
  constexpr double kLeastShare = 0.55;
  if (!record->within_threshold) return true;
  const double share = record->patch.area_mm2 / record->within_threshold->area_mm2;
  if (share > 1) {
    record->problem =
        "the law of lift-off does not hold: by it more touches than lies within the threshold";
    return false;
  }
  if (share > kLeastShare) return true;
  record->problem =
      "the law of lift-off does not hold: by it little touches of what lies within the threshold";
  return false;
}

}  // namespace

void PatchSeriesOptions::Check() const {
  lift_off.Check();
  threshold.Check();
  carcass.Check();
  if (!(sigma_mm > 0)) throw UsageError("The sigma of the points must be positive.");
  if (!(sigma_depth_mm >= 0) || !(sigma_ellipse_mm >= 0)) {
    throw UsageError("What the law of lift-off leaves out has sigmas of 0 mm or more.");
  }
  if (!(correlation_area_points >= 1)) {
    throw UsageError("At least one point shares a point's noise: its own.");
  }
}

PatchSeries FindPatches(std::span<const PatchFrame> frames, const WheelAxis& axis,
                        const NeighbourCorrelation& neighbours, const PatchSeriesOptions& options) {
  options.Check();
  for (const PatchFrame& frame : frames) {
    if (!frame.along_modes_mm.empty() && frame.rotation.found &&
        frame.along_modes_mm.size() != frame.rotation.ground.along_modes.size()) {
      throw std::invalid_argument("FindPatches: points and ground with different modes");
    }
  }
  PatchSeries series;
  std::string no_law;
  const std::optional<LawOfRun> law = LawOf(frames, axis, options, &no_law);
  if (law) series.law = law->law;
  for (const PatchFrame& frame : frames) {
    FramePatch& record = series.frames.emplace_back();
    if (!frame.rotation.found) {
      record.problem = frame.rotation.problem;
      continue;
    }
    const PatchOfFrame patch(frame, axis, options);
    std::string why;
    record.within_threshold = patch.WithinThreshold(&why);
    record.problem = no_law;
    if (law && patch.FindByLaw(*law, &record) && Holds(&record)) continue;
    if (!record.within_threshold) record.problem = why;
    patch.FindWithinThreshold(neighbours, &record);
  }
  return series;
}

}  // namespace plumbline
