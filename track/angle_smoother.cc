#include "track/angle_smoother.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/angle_sweep.h"
#include "track/internal/maximise.h"

namespace plumbline {
namespace {

using internal::AngleSeries;
using internal::AngleSweep;
using internal::SweepAngles;

constexpr double kNotMeasured = AngleSeries::kNotMeasured;

// What was measured, one after the other: the angles of all frames, then the turns to the next.
double& VarianceOf(AngleSeries& series, std::size_t at) {
  return at < series.size() ? series.variance[at] : series.turn_variance[at - series.size()];
}
double VarianceOf(const AngleSeries& series, std::size_t at) {
  return at < series.size() ? series.variance[at] : series.turn_variance[at - series.size()];
}

// What all others say against one, in its sigmas: (z - x) / sqrt(R - P).
double LeftOut(const AngleSeries& series, const AngleSweep& sweep, std::size_t at,
               double* variance) {
  const std::size_t n = series.size(), i = at % n;
  const internal::AngleState& state = sweep.state[i];
  const double R = VarianceOf(series, at);
  const double P = std::min(at < n ? state.var_measured : state.var_turn, R * (1 - 1e-9));
  *variance = R * R / (R - P);  // of z less what the others alone say
  const double off = at < n ? series.value[i] - state.measured
                            : series.turn[i] - (sweep.state[i + 1].angle - state.angle);
  return off / std::sqrt(R - P);
}

// log10 of q over the angles' median variance: from no change of acceleration to no smoothing.
constexpr double kLowest = -9, kHighest = 5;

double MedianVariance(const AngleSeries& series) {
  std::vector<double> finite;
  for (const double v : series.variance) {
    if (std::isfinite(v)) finite.push_back(v);
  }
  return finite.empty() ? 1 : Median(std::move(finite));
}

double RobustNoise(const AngleSeries& series) {
  const double unit = MedianVariance(series);
  return unit *
         std::pow(
             10, internal::Maximise(kLowest, kHighest, internal::SearchSteps(), [&](double log_q) {
               const AngleSweep sweep = SweepAngles(series, unit * std::pow(10, log_q));
               double sum = 0;
               constexpr double kFreedom = 4;
               for (std::size_t at = 0; at < 2 * series.size(); ++at) {
                 if (!std::isfinite(VarianceOf(series, at))) continue;
                 double variance = 0;
                 const double t = LeftOut(series, sweep, at, &variance);
                 sum -= (kFreedom + 1) / 2 * std::log1p(t * t / kFreedom) + std::log(variance) / 2;
               }
               return sum;
             }));
}

double ScatterOf(const AngleSweep& sweep) {
  if (sweep.innovations + AngleSweep::kOfState < SmoothedAngles::kEnoughForScatter) return 1;
  return std::sqrt(std::max(1.0, sweep.chi2 / sweep.innovations));
}

double LikelyNoise(const AngleSeries& series) {
  const double unit = MedianVariance(series);
  return unit *
         std::pow(10,
                  internal::Maximise(kLowest, kHighest, internal::SearchSteps(), [&](double log_q) {
                    const AngleSweep sweep = SweepAngles(series, unit * std::pow(10, log_q));
                    const double scatter = ScatterOf(sweep);
                    return -(sweep.chi2 / (scatter * scatter) + sweep.log_variance +
                             2 * sweep.innovations * std::log(scatter)) /
                           2;
                  }));
}

using Outliers = std::vector<bool>;  // of what was measured

// Marks what the others contradict, the worst first.
void FindOutliers(AngleSeries& series, const std::optional<double>& q, double most_sigmas,
                  Outliers& outliers) {
  constexpr int kFewest = 6;  // that can outvote one
  int left = 0;
  for (std::size_t at = 0; at < outliers.size(); ++at) {
    if (std::isfinite(VarianceOf(series, at))) ++left;
  }
  while (left >= kFewest) {
    const AngleSweep sweep = SweepAngles(series, q ? *q : RobustNoise(series));
    std::vector<double> off(outliers.size(), 0), finite;
    for (std::size_t at = 0; at < off.size(); ++at) {
      if (!std::isfinite(VarianceOf(series, at))) continue;
      double variance = 0;
      off[at] = std::abs(LeftOut(series, sweep, at, &variance));
      finite.push_back(off[at]);
    }
    constexpr double kMedianOfNormal = 0.6745;
    const double scatter = std::max(1.0, Median(std::move(finite)) / kMedianOfNormal);
    const auto worst = std::max_element(off.begin(), off.end());
    if (!(*worst > most_sigmas * scatter)) return;
    const auto at = static_cast<std::size_t>(worst - off.begin());
    VarianceOf(series, at) = kNotMeasured;
    outliers[at] = true;
    --left;
  }
}

// Outliers of one kind that follow each other, or at an end, where others are on one side alone.
void CollectRuns(std::size_t begin, std::size_t end, const AngleSeries& before,
                 const Outliers& outliers, std::vector<std::size_t>* taken) {
  constexpr std::size_t kRun = 3;
  std::vector<std::size_t> run;
  bool from_the_start = true;
  for (std::size_t at = begin; at <= end; ++at) {
    if (at < end && !std::isfinite(VarianceOf(before, at))) continue;
    if (at < end && outliers[at]) {
      run.push_back(at);
      continue;
    }
    if (run.size() >= kRun || from_the_start || at == end) {
      taken->insert(taken->end(), run.begin(), run.end());
    }
    from_the_start = false;
    run.clear();
  }
}

// Frames that are left out in a row do not err independently of each other: rather the motion has
// changed, which a noise that suits the rest does not allow; so it may at an end, to where the
// others only lead on. They count again where under the likeliest noise with them nothing
// contradicts them.
void TakeBackRuns(AngleSeries& series, double most_sigmas, Outliers& outliers,
                  const AngleSeries& before) {
  std::vector<std::size_t> taken;
  CollectRuns(0, series.size(), before, outliers, &taken);
  CollectRuns(series.size(), 2 * series.size(), before, outliers, &taken);
  if (taken.empty()) return;
  AngleSeries with = series;
  for (const std::size_t at : taken) VarianceOf(with, at) = VarianceOf(before, at);
  Outliers again(outliers.size());
  AngleSeries checked = with;
  FindOutliers(checked, LikelyNoise(with), most_sigmas, again);
  if (std::find(again.begin(), again.end(), true) != again.end()) return;
  series = std::move(with);
  for (const std::size_t at : taken) outliers[at] = false;
}

// Less a straight line through them, so that what is left is small.
struct Line {
  double at_0 = 0, slope = 0;
};

Line LineThrough(const std::vector<double>& t, std::span<const double> z) {
  double n = 0, st = 0, sz = 0, stt = 0, stz = 0;
  for (std::size_t i = 0; i < t.size(); ++i) {
    if (!std::isfinite(z[i])) continue;
    n += 1;
    st += t[i];
    sz += z[i];
    stt += t[i] * t[i];
    stz += t[i] * z[i];
  }
  if (n == 0) return {};
  const double det = n * stt - st * st;
  Line line;
  line.slope = n > 1 && det > 0 ? (n * stz - st * sz) / det : 0;
  line.at_0 = (sz - line.slope * st) / n;
  return line;
}

// Vague against what the angles say.
void SetStart(AngleSeries& series) {
  constexpr double kVague = 1e4, kRoom = 100;
  double sigma = 0, farthest = 0;
  for (std::size_t i = 0; i < series.value.size(); ++i) {
    if (!std::isfinite(series.variance[i])) continue;
    sigma = std::max(sigma, std::sqrt(series.variance[i]));
    farthest = std::max(farthest, std::abs(series.value[i]));
  }
  const double start = kVague * sigma + kRoom * farthest;
  if (start > 0) series.start_variance = start * start;
}

void CheckInput(std::span<const double> times, std::span<const double> angles,
                std::span<const double> sigmas, const Eigen::MatrixXd& along) {
  if (angles.size() != times.size() || sigmas.size() != times.size() ||
      (along.rows() > 0 && along.cols() != static_cast<Eigen::Index>(times.size()))) {
    throw std::invalid_argument("times, angles, their sigmas and changes must be of one length");
  }
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (!std::isfinite(times[i]) || (i > 0 && !(times[i] > times[i - 1]))) {
      throw std::invalid_argument("the times of the frames must grow");
    }
    if (std::isfinite(angles[i]) && !(sigmas[i] > 0 && std::isfinite(sigmas[i]))) {
      throw std::invalid_argument("the sigma of an angle must be positive");
    }
  }
}

void CheckTurns(const AngleTurns& turns, std::size_t frames) {
  const std::size_t pairs = frames > 0 ? frames - 1 : 0;
  const auto fits = [&](const std::vector<double>& of_pairs) {
    return of_pairs.empty() || of_pairs.size() == pairs;
  };
  if (!fits(turns.turn_rad) || turns.sigma_rad.size() != turns.turn_rad.size() ||
      !fits(turns.drift_rad) ||
      (turns.along_rad.rows() > 0 && turns.along_rad.cols() != static_cast<Eigen::Index>(pairs))) {
    throw std::invalid_argument("turns and drifts must be of one less than the frames");
  }
  for (std::size_t i = 0; i < turns.turn_rad.size(); ++i) {
    if (std::isfinite(turns.turn_rad[i]) &&
        !(turns.sigma_rad[i] > 0 && std::isfinite(turns.sigma_rad[i]))) {
      throw std::invalid_argument("the sigma of a turn must be positive");
    }
  }
  for (const double drift : turns.drift_rad) {
    if (!(drift >= 0 && std::isfinite(drift))) {
      throw std::invalid_argument("the drift of the angles must not be negative");
    }
  }
}

// Less the line.
AngleSeries SeriesOf(const std::vector<double>& t, const Line& line, std::span<const double> angles,
                     std::span<const double> sigmas, const AngleTurns& turns) {
  const std::size_t n = t.size();
  AngleSeries series;
  series.turn.assign(n, 0);
  series.turn_variance.assign(n, kNotMeasured);
  for (std::size_t i = 0; i < n; ++i) {
    const bool measured = std::isfinite(angles[i]);
    series.step.push_back(i > 0 ? t[i] - t[i - 1] : 0);
    series.value.push_back(measured ? angles[i] - line.at_0 - line.slope * t[i] : 0);
    series.variance.push_back(measured ? sigmas[i] * sigmas[i] : kNotMeasured);
  }
  for (std::size_t i = 0; i < turns.turn_rad.size(); ++i) {
    if (!std::isfinite(turns.turn_rad[i])) continue;
    series.turn[i] = turns.turn_rad[i] - line.slope * (t[i + 1] - t[i]);
    series.turn_variance[i] = turns.sigma_rad[i] * turns.sigma_rad[i];
  }
  if (!turns.drift_rad.empty()) {
    constexpr double kLeast = 1e-8;  // of an angle's variance: none
    const double least = kLeast * MedianVariance(series);
    for (const double drift : turns.drift_rad) {
      series.drift_variance.push_back(drift * drift + least);
    }
    series.drift_variance.push_back(least);
    series.still_variance = least;
  }
  SetStart(series);
  return series;
}

// The covariance of each smoothed angle with that of a frame: what it follows a measurement of that
// one by, times the measurement's variance. One that tells next to nothing serves where there is
// none that counts.
std::vector<double> CovariancesWith(AngleSeries series, double q, std::size_t frame) {
  constexpr double kNextToNothing = 1e8;
  if (!std::isfinite(series.variance[frame])) {
    series.variance[frame] = kNextToNothing * MedianVariance(series);
  }
  std::fill(series.value.begin(), series.value.end(), 0.0);
  std::fill(series.turn.begin(), series.turn.end(), 0.0);
  series.value[frame] = 1;
  std::vector<double> covariances;
  for (const internal::AngleState& state : SweepAngles(series, q).state) {
    covariances.push_back(state.angle * series.variance[frame]);
  }
  return covariances;
}

double FiniteOrNothing(double value) { return std::isfinite(value) ? value : 0; }

}  // namespace

void AngleSmootherOptions::Check() const {
  if (jerk_rad_s25 && !(*jerk_rad_s25 >= 0)) {
    throw UsageError("The noise of the wheel's jerk must not be negative.");
  }
  if (!(outlier_sigmas > 0)) throw UsageError("An outlier must be off by more than 0 sigmas.");
}

SmoothedAngles SmoothAngles(std::span<const double> times_s, std::span<const double> angles_rad,
                            std::span<const double> sigmas_rad, const Eigen::MatrixXd& along,
                            const AngleSmootherOptions& options, const AngleTurns& turns) {
  options.Check();
  CheckInput(times_s, angles_rad, sigmas_rad, along);
  CheckTurns(turns, times_s.size());
  SmoothedAngles out;
  const std::size_t n = times_s.size();
  out.frames.resize(n);
  out.angle_along_rad = out.speed_along_rad_s =
      Eigen::MatrixXd::Zero(along.rows(), static_cast<Eigen::Index>(n));
  out.angle_along_turns_rad = out.speed_along_turns_rad_s =
      Eigen::MatrixXd::Zero(turns.along_rad.rows(), static_cast<Eigen::Index>(n));
  if (n == 0) return out;
  const double frame_s =
      n > 1 ? (times_s.back() - times_s.front()) / static_cast<double>(n - 1) : 1;
  std::vector<double> t;
  for (const double s : times_s) t.push_back((s - times_s.front()) / frame_s);
  const Line line = LineThrough(t, angles_rad);
  AngleSeries series = SeriesOf(t, line, angles_rad, sigmas_rad, turns);
  const double per_frame = std::pow(frame_s, 5);  // rad^2 / s^5 to rad^2 / frame^5
  std::optional<double> q;
  if (options.jerk_rad_s25) {
    q = std::max(*options.jerk_rad_s25 * *options.jerk_rad_s25 * per_frame,
                 std::pow(10, kLowest) * MedianVariance(series));
  }
  const AngleSeries before = series;
  Outliers outliers(2 * n);
  FindOutliers(series, q, options.outlier_sigmas, outliers);
  if (!q) TakeBackRuns(series, options.outlier_sigmas, outliers, before);
  if (!q) q = LikelyNoise(series);
  out.scatter = ScatterOf(SweepAngles(series, *q));
  for (auto* variances : {&series.variance, &series.turn_variance, &series.drift_variance}) {
    for (double& v : *variances) v *= out.scatter * out.scatter;
  }
  if (!options.jerk_rad_s25) *q *= out.scatter * out.scatter;
  out.jerk_rad_s25 = std::sqrt(*q / per_frame);
  const AngleSweep sweep = SweepAngles(series, *q);
  const auto first =
      static_cast<std::size_t>(std::find_if(angles_rad.begin(), angles_rad.end(),
                                            [](double a) { return std::isfinite(a); }) -
                               angles_rad.begin());
  std::vector<double> with_first(n, 0.0);
  if (first < n) with_first = CovariancesWith(series, *q, first);
  for (std::size_t i = 0; i < n; ++i) {
    SmoothedAngle& frame = out.frames[i];
    const internal::AngleState& state = sweep.state[i];
    frame.angle_rad = line.at_0 + line.slope * t[i] + state.angle;
    frame.speed_rad_s = (line.slope + state.speed) / frame_s;
    frame.sigma_angle_rad = std::sqrt(std::max(0.0, state.var_angle));
    if (first < n && i != first) {
      frame.sigma_turn_rad = std::sqrt(
          std::max(0.0, state.var_angle + sweep.state[first].var_angle - 2 * with_first[i]));
    }
    frame.sigma_speed_rad_s = std::sqrt(std::max(0.0, state.var_speed)) / frame_s;
    frame.outlier = outliers[i];
    frame.turn_outlier = outliers[n + i];
    if (!std::isfinite(series.variance[i])) continue;
    frame.lean = std::clamp(1 - state.covar_measured / series.variance[i], 0.0, 1.0);
  }
  const auto follow = [&](Eigen::Index k, Eigen::MatrixXd* angle_along,
                          Eigen::MatrixXd* speed_along) {
    const AngleSweep moved = SweepAngles(series, *q);
    for (std::size_t i = 0; i < n; ++i) {
      (*angle_along)(k, static_cast<Eigen::Index>(i)) = moved.state[i].angle;
      (*speed_along)(k, static_cast<Eigen::Index>(i)) = moved.state[i].speed / frame_s;
    }
  };
  series.turn.assign(n, 0);
  for (Eigen::Index k = 0; k < along.rows(); ++k) {
    for (std::size_t i = 0; i < n; ++i) {
      series.value[i] = FiniteOrNothing(along(k, static_cast<Eigen::Index>(i)));
    }
    follow(k, &out.angle_along_rad, &out.speed_along_rad_s);
  }
  series.value.assign(n, 0);
  for (Eigen::Index k = 0; k < turns.along_rad.rows(); ++k) {
    for (std::size_t i = 0; i + 1 < n; ++i) {
      series.turn[i] = FiniteOrNothing(turns.along_rad(k, static_cast<Eigen::Index>(i)));
    }
    follow(k, &out.angle_along_turns_rad, &out.speed_along_turns_rad_s);
  }
  return out;
}

}  // namespace plumbline
