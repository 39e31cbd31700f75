#include "track/carcass_estimate.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/patch_in_ground.h"

namespace plumbline {
namespace {

// The gaps of what touches, by strips across the tread.
class Strips {
 public:
  Strips(std::span<const PatchFrame> frames, const WheelAxis& axis, const CarcassThickness& carcass,
         const PatchSeriesOptions& options)
      : axis_(axis), options_(options) {
    for (const PatchFrame& frame : frames) {
      if (frame.rotation.from == RigRotationFrame::From::kPlane && frame.rotation.found) {
        Add(frame, carcass);
      }
    }
    for (auto at = strips_.begin(); at != strips_.end();) {
      at = at->second.gaps_mm.size() < kLeastPoints ? strips_.erase(at) : std::next(at);
    }
  }

  CarcassCheck Check() {
    CarcassCheck check;
    const auto count = static_cast<Eigen::Index>(strips_.size());
    check.freedom = static_cast<int>(count) - 2;
    if (check.freedom < 1) return check;
    Eigen::VectorXd gap(count), weight(count);
    Eigen::MatrixXd line(count, 2), errors(count, static_cast<Eigen::Index>(modes_) + 1);
    Eigen::Index k = 0;
    for (auto& [place, strip] : strips_) {
      const auto points = static_cast<double>(strip.gaps_mm.size());
      gap[k] = Median(std::move(strip.gaps_mm));
      weight[k] =
          points / (kMedian * options_.correlation_area_points * std::pow(options_.sigma_mm, 2));
      line.row(k) << 1, kStrip_mm * place / kLength_mm;
      errors.row(k) = strip.errors_mm.transpose() / points;
      ++k;
    }
    const Eigen::Matrix2d normal = line.transpose() * weight.asDiagonal() * line;
    const Eigen::VectorXd off =
        gap - line * normal.ldlt().solve(line.transpose() * weight.asDiagonal() * gap);
    // What the ground absorbs may be any.
    const Eigen::MatrixXd cov = Eigen::MatrixXd(weight.cwiseInverse().asDiagonal()) +
                                errors * errors.transpose() + kAny_mm2 * line * line.transpose();
    check.chi_square = off.dot(cov.ldlt().solve(off));
    const double most = off.cwiseAbs().maxCoeff(&k);
    check.most_mm = off[k];
    check.at_y_mm = kStrip_mm * (std::next(strips_.begin(), k)->first + 0.5);
    check.contradicts = most > kLeast_mm && check.chi_square > Bound(check.freedom);
    return check;
  }

 private:
  static constexpr double kStrip_mm = 10, kLength_mm = 100, kAny_mm2 = 1, kLeast_mm = 0.03;
  static constexpr double kMedian = 1.6;  // its variance over that of the mean
  static constexpr std::size_t kLeastPoints = 20;

  struct Strip {
    std::vector<double> gaps_mm;
    Eigen::VectorXd errors_mm;  // summed over the points: along each mode, and of the curve
  };

  // The chi-square that is passed once in a million, after Wilson and Hilferty (1931).
  static double Bound(int freedom) {
    const double f = 2 / (9.0 * freedom);
    return freedom * std::pow(1 - f + 4.75 * std::sqrt(f), 3);
  }

  void Add(const PatchFrame& frame, const CarcassThickness& carcass) {
    const internal::InGround here(frame, frame.rotation.ground.frame_from_rig);
    const Image<double> left_out = ThicknessLeftOutOver(carcass, frame.undeformed_mm, axis_);
    const auto deepest = DepthInContact(here.ForLiftOff());
    if (!deepest) return;
    modes_ = frame.along_modes_mm.size();
    const auto gap_of = [](const internal::InGround& at, std::size_t i) {
      return at.position_mm.data()[i].z() - at.thickness_mm->data()[i];
    };
    std::vector<std::pair<std::size_t, Strip*>> touching;
    for (std::size_t i = 0; i < frame.point_mm.pixel_count(); ++i) {
      const double gap = gap_of(here, i);
      if (!std::isfinite(gap) ||
          !(here.undeformed_mm.data()[i].z() - here.thickness_mm->data()[i] < *deepest)) {
        continue;
      }
      const double y_mm = axis_.direction_in_rig().dot(frame.undeformed_mm.data()[i]);
      Strip& strip = strips_[static_cast<int>(std::floor(y_mm / kStrip_mm))];
      if (strip.gaps_mm.empty()) {
        strip.errors_mm.setZero(static_cast<Eigen::Index>(modes_) + 1);
      }
      strip.gaps_mm.push_back(gap);
      strip.errors_mm[static_cast<Eigen::Index>(modes_)] += left_out.data()[i];
      touching.emplace_back(i, &strip);
    }
    for (std::size_t m = 0; m < modes_; ++m) {
      internal::InGround along(frame, frame.rotation.ground.along_modes[m],
                               &frame.along_modes_mm[m]);
      along.thickness_mm =
          &ThicknessAlong(m, modes_, frame.thickness_mm, frame.thickness_along_modes);
      for (const auto& [i, strip] : touching) {
        strip->errors_mm[static_cast<Eigen::Index>(m)] += gap_of(along, i) - gap_of(here, i);
      }
    }
  }

  const WheelAxis& axis_;
  const PatchSeriesOptions& options_;
  std::size_t modes_ = 0;
  std::map<int, Strip> strips_;
};

// What touches does not tell a constant and a slope of the map apart from the ground's height and
// tilt: over the entries that it tells the correction has none, and they are as unsure as the map
// was said to be. The points beyond the contact, of which the matches make something else than the
// law says, have no say in them so.
void HoldLine(CarcassThickness* found, Eigen::MatrixXd* cov_mm2) {
  constexpr double kTold = 0.25;      // of the variance as it was said
  constexpr double kLength_mm = 100;  // so that both columns are of one size
  const double said_mm2 = found->sigma_mm * found->sigma_mm;
  const auto entries = static_cast<Eigen::Index>(found->y_mm.size());
  Eigen::MatrixXd line(entries, 2);
  Eigen::VectorXd corrected(entries), told(entries);
  for (Eigen::Index k = 0; k < entries; ++k) {
    const auto at = static_cast<std::size_t>(k);
    line.row(k) << 1, found->y_mm[at] / kLength_mm;
    corrected[k] = found->thickness_mm[at] - found->said_mm[at];
    told[k] = (*cov_mm2)(k, k) < kTold * said_mm2 ? 1 : 0;
  }
  if (told.sum() < 3) return;
  const Eigen::Matrix2d inverse = (line.transpose() * told.asDiagonal() * line).inverse();
  const Eigen::MatrixXd fit = line * inverse * line.transpose() * told.asDiagonal();
  const Eigen::VectorXd taken = fit * corrected;
  for (Eigen::Index k = 0; k < entries; ++k) {
    double& entry = found->thickness_mm[static_cast<std::size_t>(k)];
    entry = std::max(0.0, entry - taken[k]);
  }
  const Eigen::MatrixXd rest = Eigen::MatrixXd::Identity(entries, entries) - fit;
  *cov_mm2 = rest * *cov_mm2 * rest.transpose() + said_mm2 * line * inverse * line.transpose();
}

}  // namespace

ThicknessPrior PriorOf(const CarcassThickness& carcass) {
  const auto entries = static_cast<Eigen::Index>(carcass.thickness_mm.size());
  ThicknessPrior prior{Eigen::VectorXd::Zero(entries), carcass.sigma_mm};
  for (Eigen::Index k = 0; k < entries && !carcass.said_mm.empty(); ++k) {
    const auto at = static_cast<std::size_t>(k);
    prior.expected_mm[k] = carcass.said_mm[at] - carcass.thickness_mm[at];
  }
  return prior;
}

CarcassThickness EstimateCarcass(std::span<const PatchFrame> frames, const WheelAxis& axis,
                                 const CarcassThickness& carcass, const PatchSeriesOptions& options,
                                 std::string* why) {
  carcass.Check();
  options.Check();
  if (!carcass.uncertain_map()) return carcass;
  // The curve between entries is not linear in them: where it is flat it has kinks.
  constexpr int kRounds = 5;
  constexpr double kEnough_mm = 1e-4;
  CarcassThickness found = carcass;
  if (found.said_mm.empty()) found.said_mm = found.thickness_mm;
  internal::FramesOnGround ground(frames, axis, carcass);
  LawAndThickness fitted;
  try {
    for (int round = 0; round < kRounds; ++round) {
      if (round > 0) ground.SetCarcass(found);
      const ThicknessPrior prior = PriorOf(found);
      fitted = FitLawAndThickness(ground.ForLiftOff(), options.sigma_mm,
                                  options.correlation_area_points, &prior, options.lift_off);
      for (std::size_t k = 0; k < found.thickness_mm.size(); ++k) {
        double& entry = found.thickness_mm[k];
        entry = std::max(0.0, entry + fitted.added_mm[static_cast<Eigen::Index>(k)]);
      }
      if (fitted.added_mm.cwiseAbs().maxCoeff() < kEnough_mm) break;
    }
  } catch (const InputError& error) {
    if (why != nullptr) *why = error.what();
    return carcass;
  }
  ground.SetCarcass(found);
  if (!ground.Holds(fitted.law, options)) {
    if (why != nullptr) *why = "the law of lift-off holds in no frame with a map of these places";
    return carcass;
  }
  HoldLine(&found, &fitted.cov_mm2);
  found.modes_mm = Eigen::LLT<Eigen::MatrixXd>(fitted.cov_mm2).matrixL();
  return found;
}

CarcassCheck CheckCarcass(std::span<const PatchFrame> frames, const WheelAxis& axis,
                          const CarcassThickness& carcass, const PatchSeriesOptions& options) {
  options.Check();
  return Strips(frames, axis, carcass, options).Check();
}

}  // namespace plumbline
