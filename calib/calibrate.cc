#include "calib/calibrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/calibration_modes.h"
#include "calib/error.h"
#include "calib/internal/board_adjustment.h"
#include "calib/internal/calibration_advice.h"
#include "calib/internal/calibration_seed.h"
#include "calib/internal/calibration_steps.h"
#include "calib/internal/clustered_covariance.h"
#include "calib/internal/mrcal_bridge.h"
#include "calib/median.h"

namespace plumbline {
namespace {

using internal::BoardObservation;
using internal::BoardProblem;

constexpr std::size_t kWorkingPoints = 400;

// The refined board, with the similarity transform that fits it best to the nominal one taken out.
void DescribeTarget(const BoardProblem& problem, Calibration& out) {
  out.target_mm = problem.target_mm;
  out.target_seen.assign(problem.target_mm.size(), false);
  for (const BoardObservation& o : problem.observations) {
    if (!o.outlier) out.target_seen[static_cast<std::size_t>(o.id)] = true;
  }
  Eigen::Matrix3Xd refined(3, problem.target_mm.size()), nominal(3, problem.target_mm.size());
  Eigen::Index n = 0;
  for (std::size_t id = 0; id < problem.target_mm.size(); ++id) {
    if (!out.target_seen[id]) continue;
    refined.col(n) = problem.target_mm[id];
    nominal.col(n++) = problem.nominal_mm[id];
  }
  const Eigen::Matrix3Xd departure =
      internal::DepartureFromSimilar(refined.leftCols(n), nominal.leftCols(n));
  out.target_rms_in_plane_mm =
      std::sqrt(departure.topRows<2>().squaredNorm() / static_cast<double>(2 * n));
  out.target_rms_out_of_plane_mm =
      std::sqrt(departure.bottomRows<1>().squaredNorm() / static_cast<double>(n));
}

void ApplyScale(BoardProblem& problem, double factor) {
  problem.rig.right_from_left.translation_mm *= factor;
  for (Rigid3& pose : problem.left_from_board) pose.translation_mm *= factor;
  for (Eigen::Vector3d& p : problem.target_mm) p *= factor;
  for (Eigen::Vector3d& p : problem.nominal_mm) p *= factor;
  problem.disc_radius_mm *= factor;
}

// The scale from a length that somebody measured, or what is assumed of the board.
double SetScale(BoardProblem& problem, const CalibrationOptions& options) {
  if (!options.known_distance) return options.scale_sigma;
  const KnownDistance& known = *options.known_distance;
  const int count = static_cast<int>(problem.target_mm.size());
  if (known.first_id < 0 || known.second_id < 0 || known.first_id >= count ||
      known.second_id >= count || known.first_id == known.second_id) {
    throw UsageError(
        fmt::format("--known-distance names the points {} and {}; this board has the points 0 to "
                    "{}, numbered row by row",
                    known.first_id, known.second_id, count - 1));
  }
  const double length = (problem.target_mm[static_cast<std::size_t>(known.first_id)] -
                         problem.target_mm[static_cast<std::size_t>(known.second_id)])
                            .norm();
  ApplyScale(problem, known.distance_mm / length);
  return known.sigma_mm / known.distance_mm;
}

void DescribePairs(const BoardProblem& problem, const std::vector<std::string>& problems,
                   const std::vector<CalibrationPair>& pairs, Calibration& out) {
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    PairResult r;
    r.left_name = pairs[i].left_name;
    r.right_name = pairs[i].right_name;
    r.problem = problems[i];
    r.used = std::any_of(problem.observations.begin(), problem.observations.end(),
                         [&](const BoardObservation& o) { return o.pair == static_cast<int>(i); });
    r.left_points = static_cast<int>(pairs[i].left.ids.size());
    r.right_points = static_cast<int>(pairs[i].right.ids.size());
    if (r.used) {
      r.left_from_board = problem.left_from_board[i];
      r.tilt_rad = std::acos(std::clamp(std::abs(r.left_from_board.rotation(2, 2)), 0.0, 1.0));
      r.left_rms_px = internal::ResidualRms(problem, 0, static_cast<int>(i));
      r.right_rms_px = internal::ResidualRms(problem, 1, static_cast<int>(i));
    }
    out.pairs.push_back(r);
  }
  const std::vector<Eigen::Vector2d> residuals = internal::Residuals(problem);
  for (std::size_t i = 0; i < residuals.size(); ++i) {
    const BoardObservation& o = problem.observations[i];
    out.residuals.push_back({o.pair, o.camera, o.id, o.pixel, residuals[i], o.outlier});
    ++(o.outlier ? out.outlier_count : out.point_count);
    if (o.outlier) ++out.pairs[static_cast<std::size_t>(o.pair)].outliers;
  }
}

double MedianDistance(const std::vector<PairResult>& pairs) {
  std::vector<double> distances;
  for (const PairResult& p : pairs) {
    if (p.used) distances.push_back(p.left_from_board.translation_mm.norm());
  }
  return Median(std::move(distances));
}

// Board points that both cameras saw, evenly thinned: the volume that modes are chosen for.
std::vector<Eigen::Vector3d> WorkingPoints(const BoardProblem& problem) {
  std::vector<Eigen::Vector3d> all;
  for (const BoardObservation& o : problem.observations) {
    if (!o.outlier && o.camera == 1)
      all.push_back(problem.left_from_board[static_cast<std::size_t>(o.pair)] *
                    problem.target_mm[static_cast<std::size_t>(o.id)]);
  }
  if (all.size() <= kWorkingPoints) return all;
  std::vector<Eigen::Vector3d> some;
  for (std::size_t k = 0; k < kWorkingPoints; ++k)
    some.push_back(all[k * all.size() / kWorkingPoints]);
  return some;
}

void DescribeCovariance(const BoardProblem& problem, Calibration& out) {
  const bool target_free = !out.options.rigid_target;
  const internal::RigCovariance covariance =
      internal::ClusteredCovariance(problem, target_free, out.options.target_sigma_mm);
  out.covariance = covariance.clustered;
  out.covariance_independent = covariance.independent;
  out.rig.modes = ChooseModes(out.rig, out.covariance, out.scale_sigma, WorkingPoints(problem));
  const Eigen::Vector3d t = out.rig.right_from_left.translation_mm;
  const Eigen::Vector3d r = out.rig.right_from_left.RotationVector();
  out.angle_rad = r.norm();
  out.sigma_baseline_mm =
      std::sqrt(t.normalized().dot(out.covariance.bottomRightCorner<3, 3>() * t.normalized()));
  const Eigen::Index first_r = out.covariance.rows() - 6;
  if (r.norm() > 0)
    out.sigma_angle_rad = std::sqrt(
        r.normalized().dot(out.covariance.block<3, 3>(first_r, first_r) * r.normalized()));
}

HalvesComparison CompareHalves(const BoardProblem& problem, const Calibration& whole) {
  const bool target_free = !whole.options.rigid_target;
  const BoardProblem even = internal::Half(problem, 0, whole.options);
  const BoardProblem odd = internal::Half(problem, 1, whole.options);
  HalvesComparison out;
  out.baseline_difference_mm = even.rig.baseline_mm() - odd.rig.baseline_mm();
  out.angle_difference_rad = even.rig.right_from_left.RotationVector().norm() -
                             odd.rig.right_from_left.RotationVector().norm();
  // Each half has twice the variance of the whole, and their difference four times.
  out.baseline_expected_mm = 2 * whole.sigma_baseline_mm;
  out.angle_expected_rad = 2 * whole.sigma_angle_rad;
  if (target_free) out.target_rms_difference_mm = internal::TargetDifference(even, odd);
  return out;
}

}  // namespace

void CalibrationOptions::Check() const {
  if (!(target_sigma_mm > 0))
    throw UsageError(fmt::format("--target-sigma must be above 0 mm, not {}", target_sigma_mm));
  if (!(scale_sigma >= 0))
    throw UsageError(
        fmt::format("--scale-sigma must be 0 or more (relative), not {}", scale_sigma));
  if (!(outlier_sigmas > 2))
    throw UsageError(
        fmt::format("the outlier limit must be above 2 sigma, not {}", outlier_sigmas));
  if (known_distance && !(known_distance->distance_mm > 0 && known_distance->sigma_mm > 0)) {
    throw UsageError(
        "--known-distance needs a distance and a sigma above 0 mm, for example 0:13:91.02:0.02");
  }
}

Calibration Calibrate(const BoardSpec& board, ImageSize left_size, ImageSize right_size,
                      const std::vector<CalibrationPair>& pairs, const CalibrationOptions& options,
                      const std::function<void(const std::string&)>& progress) {
  options.Check();
  const auto say = [&](const std::string& what) {
    if (progress) progress(what);
  };
  std::vector<ModelScore> scores;
  LensModel model;
  if (options.model) {
    model = *options.model;
  } else {
    say("choosing the lens model by cross-validation");
    scores = internal::ScoreModels(board, left_size, right_size, pairs, options);
    model = internal::SimplestOfTheBest(scores);
  }
  say(fmt::format("seeding {}", model.Name()));
  internal::CalibrationSeed seed =
      internal::SeedCalibration(board, model, left_size, right_size, pairs);
  say("robust solve by mrcal");
  internal::SolveRobustly(seed.problem);
  say("joint adjustment with a rigid board");
  internal::Refine(seed.problem, options, true);
  internal::DropBadPairs(seed, options);
  const double rigid_rms_px = internal::ResidualRms(seed.problem);
  BoardProblem refined = seed.problem;
  say("joint adjustment with the board's own shape");
  internal::Refine(refined, options, false);
  const double refined_rms_px = internal::ResidualRms(refined);
  BoardProblem& problem = options.rigid_target ? seed.problem : refined;

  Calibration out(board, options, problem.rig);
  out.model_scores = std::move(scores);
  out.scale_sigma = SetScale(problem, options);
  out.rig = problem.rig;
  out.rigid_rms_px = rigid_rms_px;
  out.fixed_to_board_share = std::max(0.0, 1 - std::pow(refined_rms_px / rigid_rms_px, 2));
  out.left_rms_px = internal::ResidualRms(problem, 0);
  out.right_rms_px = internal::ResidualRms(problem, 1);
  out.joint_rms_px = internal::ResidualRms(problem);
  DescribePairs(problem, seed.pair_problems, pairs, out);
  DescribeTarget(problem, out);
  out.working_distance_mm = MedianDistance(out.pairs);
  say("covariance, clustered by pair");
  DescribeCovariance(problem, out);
  if (options.compare_halves) {
    say("comparing even and odd pairs");
    out.halves = CompareHalves(problem, out);
  }
  if (auto inputs = internal::ToOptimizationInputs(problem))
    out.optimization_inputs = std::make_shared<const OptimizationInputs>(std::move(*inputs));
  out.warnings = internal::Warnings(out);
  return out;
}

}  // namespace plumbline
