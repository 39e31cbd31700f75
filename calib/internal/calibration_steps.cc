#include "calib/internal/calibration_steps.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "calib/error.h"
#include "calib/internal/clustered_covariance.h"
#include "calib/internal/mrcal_bridge.h"
#include "calib/internal/mrcal_solver.h"
#include "calib/median.h"

namespace plumbline::internal {
namespace {

constexpr int kMaxRounds = 6;
constexpr double kBadPairFactor = 4;  // times the median RMS of all photographs
constexpr int kFolds = 4;
constexpr double kWorthwhileGain = 0.02;  // of the held-out rms: less is not worth more parameters
constexpr double kGrossSigmas =
    8;  // of the robust scatter: misread points, before the fine limit applies

// Copies the observations of the pairs that `keep` holds.
BoardProblem WithPairs(const BoardProblem& problem, const std::set<int>& keep) {
  BoardProblem out = problem;
  std::erase_if(out.observations,
                [&](const BoardObservation& o) { return !keep.contains(o.pair); });
  return out;
}

std::vector<int> PairsInUse(const BoardProblem& problem) {
  std::set<int> pairs;
  for (const BoardObservation& o : problem.observations) pairs.insert(o.pair);
  return {pairs.begin(), pairs.end()};
}

double MedianPhotographRms(const BoardProblem& problem) {
  std::vector<double> rms;
  for (int pair : PairsInUse(problem)) {
    for (int camera : {0, 1}) {
      if (const double r = ResidualRms(problem, camera, pair); r > 0) rms.push_back(r);
    }
  }
  return Median(std::move(rms));
}

// The RMS of one photograph when its board pose may be what this camera alone wants.
double AloneRms(const BoardProblem& problem, int camera, int pair) {
  BoardProblem one = WithPairs(problem, {pair});
  std::erase_if(one.observations, [&](const BoardObservation& o) { return o.camera != camera; });
  if (one.observations.size() < 6) return 0;
  for (BoardObservation& o : one.observations) o.outlier = false;
  Adjust(one, {.fix_cameras = true, .fix_target = true});
  return ResidualRms(one);
}

std::string WhyBad(const BoardProblem& problem, int pair, double median_px) {
  const double left = AloneRms(problem, 0, pair);
  const double right = AloneRms(problem, 1, pair);
  const double limit = kBadPairFactor * median_px;
  if (left <= limit && right <= limit) {
    return fmt::format(
        "each photograph fits its camera ({:.2f} and {:.2f} px) but not the other one: not taken "
        "at the same moment",
        left, right);
  }
  const char* side = left > limit && right > limit ? "both photographs do"
                     : left > limit                ? "the left photograph does"
                                                   : "the right photograph does";
  return fmt::format(
      "{} not fit the camera ({:.2f} and {:.2f} px rms, the others {:.2f}): blurred, misread, "
      "bent, or of another camera",
      side, left, right, median_px);
}

}  // namespace

void SolveRobustly(BoardProblem& problem) {
  std::optional<OptimizationInputs> inputs = ToOptimizationInputs(problem);
  if (!inputs) {
    if (problem.rig.left.model().IsSplined()) {
      problem.spline_anchor = {problem.rig.left.parameters(), problem.rig.right.parameters()};
    }
    Adjust(problem, {.fix_target = true, .robust = true, .max_iterations = 100});
    MarkOutliers(problem, kGrossSigmas);
    return;
  }
  // Poses first, then the lenses' cores, then everything. Outliers are marked between solves, by
  // the robust scatter of the residuals: libmrcal's own rejection takes the structure that a bent
  // board leaves for bad points, by the hundred.
  const auto solve = [&](bool core, bool distortions, bool regularised) {
    inputs->do_optimize_intrinsics_core = core;
    inputs->do_optimize_intrinsics_distortions = distortions;
    inputs->do_apply_regularization = regularised;
    return SolveWithMrcal(*inputs);
  };
  solve(false, false, true);
  solve(true, false, true);
  // A spline can imitate its own core: the core stays where the pinhole solve put it.
  const bool splined = inputs->lens_model.IsSplined();
  solve(!splined, true, true);
  for (int round = 0; round < kMaxRounds; ++round) {
    const MrcalSolveResult result = solve(!splined, true, splined);
    if (!result.usable()) {
      throw InputError("the cameras cannot be calibrated from these photographs: " +
                       result.problem);
    }
    TakeSolution(*inputs, problem);
    if (splined)
      problem.spline_anchor = {problem.rig.left.parameters(), problem.rig.right.parameters()};
    if (MarkOutliers(problem, kGrossSigmas) == 0) return;
    inputs = ToOptimizationInputs(problem);
  }
}

void Refine(BoardProblem& problem, const CalibrationOptions& options, bool rigid_target) {
  for (int round = 0; round < kMaxRounds; ++round) {
    PredictDiscOffsets(problem);
    Adjust(problem, {.fix_target = rigid_target, .target_sigma_mm = options.target_sigma_mm});
    const int changed = MarkOutliers(problem, options.outlier_sigmas);
    EstimateFloor(problem, !rigid_target);
    if (changed == 0 && round >= 2) return;
  }
}

void DropBadPairs(CalibrationSeed& seed, const CalibrationOptions& options) {
  for (int round = 0; round < kMaxRounds; ++round) {
    const double median_px = MedianPhotographRms(seed.problem);
    std::map<int, int> points, outliers;
    for (const BoardObservation& o : seed.problem.observations) {
      ++points[o.pair];
      if (o.outlier) ++outliers[o.pair];
    }
    std::set<int> keep;
    bool dropped = false;
    for (const auto& [pair, count] : points) {
      const bool mostly_outliers = outliers[pair] > 0.3 * count;
      const double worst =
          std::max(ResidualRms(seed.problem, 0, pair), ResidualRms(seed.problem, 1, pair));
      if (!mostly_outliers && worst <= kBadPairFactor * median_px) {
        keep.insert(pair);
        continue;
      }
      seed.pair_problems[static_cast<std::size_t>(pair)] = WhyBad(seed.problem, pair, median_px);
      dropped = true;
    }
    if (!dropped) return;
    if (keep.size() < 4)
      throw InputError(
          "fewer than 4 pairs of photographs agree with each other; check that left and right are "
          "paired rightly and show the same moments");
    seed.problem = WithPairs(seed.problem, keep);
    Refine(seed.problem, options, true);
  }
}

BoardProblem Half(const BoardProblem& problem, int first, const CalibrationOptions& options) {
  const std::vector<int> pairs = PairsInUse(problem);
  std::set<int> keep;
  for (std::size_t i = static_cast<std::size_t>(first); i < pairs.size(); i += 2)
    keep.insert(pairs[i]);
  BoardProblem half = WithPairs(problem, keep);
  Adjust(half, {.fix_target = options.rigid_target, .target_sigma_mm = options.target_sigma_mm});
  return half;
}

Eigen::Matrix3Xd DepartureFromSimilar(const Eigen::Matrix3Xd& from, const Eigen::Matrix3Xd& to) {
  const Eigen::Matrix4d fit = Eigen::umeyama(from, to, true);
  return (fit.topLeftCorner<3, 3>() * from).colwise() + fit.topRightCorner<3, 1>().eval() - to;
}

double TargetDifference(const BoardProblem& a, const BoardProblem& b) {
  std::vector<bool> seen_a(a.target_mm.size(), false), seen_b(a.target_mm.size(), false);
  for (const BoardObservation& o : a.observations) seen_a[static_cast<std::size_t>(o.id)] = true;
  for (const BoardObservation& o : b.observations) seen_b[static_cast<std::size_t>(o.id)] = true;
  Eigen::Matrix3Xd from(3, a.target_mm.size()), to(3, a.target_mm.size());
  Eigen::Index n = 0;
  for (std::size_t id = 0; id < a.target_mm.size(); ++id) {
    if (!seen_a[id] || !seen_b[id]) continue;
    from.col(n) = a.target_mm[id];
    to.col(n++) = b.target_mm[id];
  }
  if (n < 4) return 0;
  const Eigen::Matrix3Xd difference = DepartureFromSimilar(from.leftCols(n), to.leftCols(n));
  return std::sqrt(difference.squaredNorm() / static_cast<double>(3 * n));
}

std::vector<ModelScore> ScoreModels(const BoardSpec& board, ImageSize left_size,
                                    ImageSize right_size, const std::vector<CalibrationPair>& pairs,
                                    const CalibrationOptions& options) {
  std::vector<ModelScore> scores;
  std::vector<std::vector<double>> mean_square;  // model, held-out pair
  for (const LensModel::Kind kind :
       {LensModel::Kind::kOpenCv4, LensModel::Kind::kOpenCv5, LensModel::Kind::kOpenCv8}) {
    LensModel model;
    model.kind = kind;
    CalibrationSeed seed = SeedCalibration(board, model, left_size, right_size, pairs);
    try {
      SolveRobustly(seed.problem);
      Refine(seed.problem, options, true);
      DropBadPairs(seed, options);
      if (!options.rigid_target) Refine(seed.problem, options, false);
      // Throws where the photographs leave a parameter open: such a model is no candidate.
      (void)ClusteredCovariance(seed.problem, !options.rigid_target, options.target_sigma_mm);
    } catch (const InputError&) {
      if (scores.empty()) throw;  // the simplest model: nothing left to fall back on
      scores.push_back({model, std::numeric_limits<double>::infinity(), 0});
      mean_square.emplace_back();
      continue;
    }
    const std::vector<int> in_use = PairsInUse(seed.problem);
    std::vector<double> squares;
    for (int fold = 0; fold < kFolds; ++fold) {
      std::set<int> train, held_out;
      for (std::size_t i = 0; i < in_use.size(); ++i)
        (static_cast<int>(i) % kFolds == fold ? held_out : train).insert(in_use[i]);
      BoardProblem fitted = WithPairs(seed.problem, train);
      Adjust(fitted,
             {.fix_target = options.rigid_target, .target_sigma_mm = options.target_sigma_mm});
      BoardProblem test = WithPairs(seed.problem, held_out);
      test.rig = fitted.rig;
      test.target_mm = fitted.target_mm;
      Adjust(test, {.fix_cameras = true, .fix_target = true});
      for (int pair : held_out) squares.push_back(std::pow(ResidualRms(test, -1, pair), 2));
    }
    double sum = 0;
    for (double s : squares) sum += s;
    ModelScore score;
    score.model = model;
    score.held_out_rms_px = std::sqrt(sum / static_cast<double>(squares.size()));
    scores.push_back(score);
    mean_square.push_back(std::move(squares));
  }
  // The standard error of the paired difference of mean squares to the best model, as a difference
  // in RMS.
  std::size_t best = 0;
  for (std::size_t m = 1; m < scores.size(); ++m) {
    if (scores[m].held_out_rms_px < scores[best].held_out_rms_px) best = m;
  }
  for (std::size_t m = 0; m < scores.size(); ++m) {
    const std::size_t n = std::min(mean_square[m].size(), mean_square[best].size());
    if (n == 0) continue;
    double mean = 0, variance = 0;
    for (std::size_t i = 0; i < n; ++i)
      mean += (mean_square[m][i] - mean_square[best][i]) / static_cast<double>(n);
    for (std::size_t i = 0; i < n; ++i)
      variance +=
          std::pow(mean_square[m][i] - mean_square[best][i] - mean, 2) / static_cast<double>(n - 1);
    scores[m].held_out_sigma_px =
        std::sqrt(variance / static_cast<double>(n)) / (2 * scores[best].held_out_rms_px);
  }
  return scores;
}

LensModel SimplestOfTheBest(const std::vector<ModelScore>& scores) {
  const auto best = std::min_element(
      scores.begin(), scores.end(),
      [](const auto& a, const auto& b) { return a.held_out_rms_px < b.held_out_rms_px; });
  for (const ModelScore& s : scores) {  // ordered by number of parameters
    const double margin_px = std::max(s.held_out_sigma_px, kWorthwhileGain * best->held_out_rms_px);
    if (s.held_out_rms_px <= best->held_out_rms_px + margin_px) return s.model;
  }
  return best->model;
}

}  // namespace plumbline::internal
