#include "track/wheel_adjustment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/wheel_equations.h"

namespace plumbline {
namespace {

using internal::WheelEquations;
constexpr Eigen::Index kAxis = WheelAdjustment::kAxis;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Axis, angles and points on their way.
struct Values {
  WheelAxis axis;
  std::vector<double> angles_rad;
  std::vector<Eigen::Vector3d> points_mm;

  Values After(const WheelEquations::Step& step, double share) const {
    Values out = *this;
    out.axis.rotation *= RotationFromVector(share * step.core.head<3>());
    out.axis.distance_mm += share * step.core[3];
    for (std::size_t f = 0; f < angles_rad.size(); ++f) {
      out.angles_rad[f] += share * step.core[kAxis + static_cast<Eigen::Index>(f)];
    }
    for (std::size_t p = 0; p < points_mm.size(); ++p) out.points_mm[p] += share * step.points[p];
    return out;
  }
};

class Adjustment {
 public:
  Adjustment(const StereoRig& rig, const WheelProblem& problem,
             const WheelAdjustmentOptions& options)
      : rig_(rig),
        problem_(problem),
        options_(options),
        equations_(rig, problem),
        values_{problem.axis, problem.angles_rad, problem.points_mm},
        weights_(equations_.size(), 1) {}

  WheelAdjustment Run() {
    if (!Evaluate(values_)) {
      throw InputError(
          "wheel adjustment: a point is behind its camera at the start; axis, angles and points "
          "need better starting values");
    }
    constexpr double kNear = 1, kThere = 1e-7;  // of what the sum of squares still falls by
    Iterate([this] { WeighByCauchy(); }, kNear);
    constexpr int kRounds = 2;
    for (int round = 0; round < kRounds; ++round) {
      LeaveOutliersOut();
      Iterate([] {}, kThere);
    }
    return Result();
  }

 private:
  bool Evaluate(const Values& values) {
    return equations_.Evaluate(values.axis, values.angles_rad, values.points_mm);
  }

  // Squared residuals over their median: of two dimensions, 2 ln 2 sigma^2.
  double ScatterSquared() const {
    std::vector<double> squares;
    for (std::size_t i = 0; i < equations_.size(); ++i) {
      squares.push_back(equations_.row(i).residual.squaredNorm());
    }
    return std::max(Median(std::move(squares)) / (2 * std::log(2.0)), 1e-12);
  }

  void WeighByCauchy() {
    const double limit2 =
        options_.loss_scale_sigmas * options_.loss_scale_sigmas * ScatterSquared();
    for (std::size_t i = 0; i < weights_.size(); ++i) {
      weights_[i] = 1 / (1 + equations_.row(i).residual.squaredNorm() / limit2);
    }
  }

  void LeaveOutliersOut() {
    const double limit2 = options_.outlier_sigmas * options_.outlier_sigmas * ScatterSquared();
    for (std::size_t i = 0; i < weights_.size(); ++i) {
      weights_[i] = equations_.row(i).residual.squaredNorm() <= limit2 ? 1 : 0;
    }
  }

  double SumOfSquares() const {
    double sum = 0;
    for (std::size_t i = 0; i < weights_.size(); ++i) {
      sum += weights_[i] * equations_.row(i).residual.squaredNorm();
    }
    return sum;
  }

  // Gauss-Newton; a step that makes things worse is shortened.
  template <typename Weigh>
  void Iterate(const Weigh& weigh, double enough) {
    converged_ = false;
    while (iterations_ < options_.max_iterations && !converged_) {
      ++iterations_;
      weigh();
      equations_.Reduce(weights_);
      const double before = SumOfSquares();
      const WheelEquations::Step step = equations_.Solve(
          [this](std::size_t i) -> const Eigen::Vector2d& { return equations_.row(i).residual; });
      constexpr double kShortest = 1e-3;
      double share = 1;
      std::optional<Values> next;
      for (; share > kShortest && !next; share /= 4) {
        Values tried = values_.After(step, share);
        const bool seen = Evaluate(tried);
        if (seen && SumOfSquares() <= before + 1e-9 * std::abs(before)) next = std::move(tried);
      }
      if (!next) {  // rounding is all that is left
        Evaluate(values_);
        converged_ = step.decrement < 1e-3;
        return;
      }
      values_ = std::move(*next);
      converged_ = step.decrement < enough;
    }
  }

  WheelAdjustment Result() {
    WheelAdjustment out;
    equations_.Reduce(weights_);
    out.axis = values_.axis;
    out.angles_rad = values_.angles_rad;
    out.points_mm = values_.points_mm;
    out.converged = converged_;
    out.iterations = iterations_;
    out.chi2 = SumOfSquares();
    out.degrees_of_freedom = equations_.rows() - equations_.unknowns();
    out.sigma0 = out.degrees_of_freedom > 0 ? std::sqrt(out.chi2 / out.degrees_of_freedom) : 0;
    for (const double w : weights_) {
      out.used.push_back(w > 0 ? 1 : 0);
      out.outliers += w > 0 ? 0 : 1;
    }
    AddCovariances(out);
    AddModes(out);
    MarkUndetermined(out);
    return out;
  }

  void AddCovariances(WheelAdjustment& out) const {
    const double scale = std::max(1.0, out.sigma0 * out.sigma0);
    const Eigen::MatrixXd cov = equations_.CoreCovariance();
    out.cov_points_mm2.resize(out.points_mm.size(), Eigen::Matrix3d::Constant(kNone));
    out.point_errors.resize(out.points_mm.size());
    for (std::size_t p = 0; p < out.points_mm.size(); ++p) {
      if (!equations_.PointDetermined(p)) continue;
      out.point_errors[p] = equations_.ErrorOf(p);
      out.cov_points_mm2[p] = scale * equations_.PointCovariance(p, cov);
      out.point_errors[p].own_mm2 *= scale;
    }
    out.cov_random = scale * cov;
  }

  // The pixels held, another rig: the residuals change, and one step leads to the new minimum.
  void AddModes(WheelAdjustment& out) const {
    const int modes = rig_.modes.count();
    out.along_modes = Eigen::MatrixXd::Zero(modes, equations_.core_size());
    out.points_along_modes_mm.assign(out.points_mm.size(), Eigen::Matrix3Xd::Zero(3, modes));
    for (int k = 0; k < modes; ++k) {
      const std::vector<Eigen::Vector2d> change =
          k == problem_.late_mode ? equations_.ChangeForLater(problem_.sigma_late_rad)
                                  : equations_.ChangeFor(rig_.AlongMode(k));
      const WheelEquations::Step step =
          equations_.Solve([&](std::size_t i) -> const Eigen::Vector2d& { return change[i]; });
      out.along_modes.row(k) = step.core.transpose();
      for (std::size_t p = 0; p < step.points.size(); ++p) {
        out.points_along_modes_mm[p].col(k) = step.points[p];
      }
    }
  }

  void MarkUndetermined(WheelAdjustment& out) const {
    for (std::size_t p = 0; p < out.points_mm.size(); ++p) {
      if (equations_.PointDetermined(p)) continue;
      out.points_mm[p].setConstant(kNone);
      out.points_along_modes_mm[p].setConstant(kNone);
    }
    for (std::size_t f = 0; f < out.angles_rad.size(); ++f) {
      if (equations_.FrameDetermined(f)) continue;
      const Eigen::Index at = kAxis + static_cast<Eigen::Index>(f);
      out.angles_rad[f] = kNone;
      out.cov_random.row(at).setConstant(kNone);
      out.cov_random.col(at).setConstant(kNone);
      out.along_modes.col(at).setConstant(kNone);
    }
  }

  const StereoRig& rig_;
  const WheelProblem& problem_;
  const WheelAdjustmentOptions& options_;
  WheelEquations equations_;
  Values values_;
  std::vector<double> weights_;
  bool converged_ = false;
  int iterations_ = 0;
};

}  // namespace

void WheelAdjustmentOptions::Check() const {
  if (!(loss_scale_sigmas > 0)) {
    throw UsageError("wheel adjustment: loss_scale_sigmas must be positive");
  }
  if (!(outlier_sigmas >= 2)) {
    throw UsageError("wheel adjustment: outlier_sigmas must be 2 or more");
  }
  if (max_iterations < 1) throw UsageError("wheel adjustment: max_iterations must be at least 1");
}

double WheelAdjustment::VarianceOfSum(std::span<const int> points,
                                      std::span<const Eigen::Vector3d> derivatives) const {
  Eigen::VectorXd by_core = Eigen::VectorXd::Zero(cov_random.rows());
  std::vector<Eigen::Index> touched;
  double variance = 0;
  for (std::size_t n = 0; n < points.size(); ++n) {
    const auto p = static_cast<std::size_t>(points[n]);
    const PointError& error = point_errors.at(p);
    if (!points_mm[p].allFinite()) return kNone;
    variance += derivatives[n].dot(error.own_mm2 * derivatives[n]);
    for (std::size_t k = 0; k < error.core.size(); ++k) {
      by_core[error.core[k]] -=
          error.transfer.col(static_cast<Eigen::Index>(k)).dot(derivatives[n]);
      touched.push_back(error.core[k]);
    }
  }
  std::sort(touched.begin(), touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());
  for (const Eigen::Index a : touched) {
    for (const Eigen::Index b : touched) variance += by_core[a] * cov_random(a, b) * by_core[b];
  }
  return variance;
}

WheelAdjustment AdjustWheel(const StereoRig& rig, const WheelProblem& problem,
                            const WheelAdjustmentOptions& options) {
  options.Check();
  if (problem.observations.empty()) {
    throw InputError("wheel adjustment: there is no observation");
  }
  return Adjustment(rig, problem, options).Run();
}

std::vector<double> TurningSpeeds(std::span<const double> angles_rad,
                                  std::span<const double> times_s) {
  std::vector<double> speeds(angles_rad.size(), kNone);
  const auto known = [&](std::size_t f) {
    return f < angles_rad.size() && std::isfinite(angles_rad[f]) && std::isfinite(times_s[f]);
  };
  for (std::size_t f = 0; f < speeds.size(); ++f) {
    const std::size_t from = f > 0 && known(f - 1) ? f - 1 : f, to = known(f + 1) ? f + 1 : f;
    if (!known(f) || from == to) continue;
    speeds[f] = (angles_rad[to] - angles_rad[from]) / (times_s[to] - times_s[from]);
  }
  return speeds;
}

WheelAdjustment AdjustLateWheel(const StereoRig& rig, WheelProblem problem,
                                std::span<const double> times_s, const RightDelay& delay,
                                int delay_mode, const WheelAdjustmentOptions& options) {
  delay.Check();
  WheelAdjustment first = AdjustWheel(rig, problem, options);
  if (!delay.any()) return first;
  const std::vector<double> speeds = TurningSpeeds(first.angles_rad, times_s);
  for (std::size_t f = 0; f < speeds.size(); ++f) {
    if (std::isfinite(first.angles_rad[f]) && !std::isfinite(speeds[f])) {
      throw InputError(
          "how far the wheel turns until the right camera exposes is not known: the frames need "
          "times, and each one a neighbour on the wheel");
    }
    const double speed = std::isfinite(speeds[f]) ? speeds[f] : 0;
    problem.late_rad.push_back(speed * delay.value_s);
    problem.sigma_late_rad.push_back(speed * delay.sigma_s);
  }
  problem.late_mode = delay_mode;
  return AdjustWheel(rig, problem, options);
}

}  // namespace plumbline
