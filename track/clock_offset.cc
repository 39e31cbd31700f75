#include "track/clock_offset.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/error.h"
#include "calib/median.h"

namespace plumbline {
namespace {

constexpr double kLikelyAsWell = 25;  // 2 log likelihood: 5 sigma
constexpr double kRipple = 1;         // of the likelihood, as samples come and go at the ends
constexpr int kLeastSamples = 8;
constexpr double kLeastCorrelation = 0.5;

SampledSignal WithoutDropouts(const SampledSignal& signal) {
  SampledSignal whole;
  for (std::size_t i = 0; i < signal.value.size(); ++i) {
    if (!std::isfinite(signal.value[i])) continue;
    whole.time_s.push_back(signal.time_s[i]);
    whole.value.push_back(signal.value[i]);
  }
  return whole;
}

double MedianInterval(const SampledSignal& signal) {
  std::vector<double> intervals;
  for (std::size_t i = 1; i < signal.time_s.size(); ++i) {
    intervals.push_back(signal.time_s[i] - signal.time_s[i - 1]);
  }
  return Median(std::move(intervals));
}

bool Changes(const SampledSignal& signal) {
  const auto [low, high] = std::minmax_element(signal.value.begin(), signal.value.end());
  return *high > *low;
}

// A signal joined by straight lines, and its integral.
class Joined {
 public:
  explicit Joined(const SampledSignal& signal) : signal_(signal), integral_(signal.value.size()) {
    for (std::size_t i = 1; i < integral_.size(); ++i) {
      integral_[i] = integral_[i - 1] + (signal.time_s[i] - signal.time_s[i - 1]) *
                                            (signal.value[i] + signal.value[i - 1]) / 2;
    }
  }
  bool Holds(double begin_s, double end_s) const {
    return begin_s >= signal_.time_s.front() && end_s <= signal_.time_s.back();
  }
  double At(double time_s) const {
    const std::size_t i = Before(time_s);
    const double share = (time_s - signal_.time_s[i]) / (signal_.time_s[i + 1] - signal_.time_s[i]);
    return signal_.value[i] + share * (signal_.value[i + 1] - signal_.value[i]);
  }
  double Mean(double begin_s, double end_s) const {
    return (Integral(end_s) - Integral(begin_s)) / (end_s - begin_s);
  }

 private:
  std::size_t Before(double time_s) const {
    const auto after =
        std::upper_bound(signal_.time_s.begin() + 1, signal_.time_s.end() - 1, time_s);
    return static_cast<std::size_t>(after - signal_.time_s.begin()) - 1;
  }
  double Integral(double time_s) const {
    const std::size_t i = Before(time_s);
    return integral_[i] + (time_s - signal_.time_s[i]) * (At(time_s) + signal_.value[i]) / 2;
  }

  const SampledSignal& signal_;
  std::vector<double> integral_;
};

// What one offset explains, with the best gain and bias for it.
struct Trial {
  ClockOffset found;
  double residual = 0;     // mean square
  double information = 0;  // of the offset: sum of squares of the slope, gain and bias taken out
  double slope_residual = 0;
};

class Search {
 public:
  Search(const SampledSignal& ours, const SampledSignal& theirs, double averaging_s,
         double least_overlap)
      : ours_(ours), theirs_(theirs), averaging_s_(averaging_s), least_overlap_(least_overlap) {}

  std::optional<Trial> Try(double offset_s) const {
    Eigen::MatrixX3d design(ours_.value.size(), 3);  // theirs, 1, d theirs / d offset
    Eigen::VectorXd values(ours_.value.size());
    Eigen::Index n = 0;
    for (std::size_t i = 0; i < ours_.value.size(); ++i) {
      const double begin = ours_.time_s[i] + offset_s - averaging_s_ / 2;
      const double end = begin + averaging_s_;
      if (!theirs_.Holds(begin, end)) continue;
      design.row(n) << theirs_.Mean(begin, end), 1,
          (theirs_.At(end) - theirs_.At(begin)) / averaging_s_;
      values[n++] = ours_.value[i];
    }
    if (n < kLeastSamples ||
        static_cast<double>(n) < least_overlap_ * static_cast<double>(ours_.value.size())) {
      return std::nullopt;
    }
    const Eigen::VectorXd x = design.col(0).head(n).array() - design.col(0).head(n).mean();
    const Eigen::VectorXd y = values.head(n).array() - values.head(n).mean();
    const Eigen::VectorXd s = design.col(2).head(n).array() - design.col(2).head(n).mean();
    const double xx = x.squaredNorm(), yy = y.squaredNorm();
    if (!(xx > 0) || !(yy > 0)) return std::nullopt;
    Trial trial;
    trial.found.offset_s = offset_s;
    trial.found.gain = x.dot(y) / xx;
    trial.found.bias = values.head(n).mean() - trial.found.gain * design.col(0).head(n).mean();
    trial.found.correlation = x.dot(y) / std::sqrt(xx * yy);
    trial.found.samples = static_cast<int>(n);
    const Eigen::VectorXd left = y - trial.found.gain * x;
    trial.residual = left.squaredNorm() / static_cast<double>(n - 3);
    const Eigen::VectorXd slope = trial.found.gain * (s - x * (x.dot(s) / xx));
    trial.information = slope.squaredNorm();
    trial.slope_residual = slope.dot(left);
    return trial;
  }

 private:
  const SampledSignal& ours_;
  Joined theirs_;
  double averaging_s_, least_overlap_;
};

// Of all samples as if they were of the number that the best trial has.
double TwiceLogLikelihood(const Trial& trial, int samples) {
  return -samples * std::log(std::max(trial.residual, std::numeric_limits<double>::min()));
}

// The best trial that is not part of the best one's own hill: beyond where the likelihood, on its
// way down from it, rises again.
double RunnerUp(const std::vector<std::optional<Trial>>& trials, std::size_t best, int samples) {
  const double top = TwiceLogLikelihood(*trials[best], samples);
  double runner_up = std::numeric_limits<double>::infinity();
  for (const int way : {-1, 1}) {
    double lowest = top;
    for (auto i = static_cast<std::ptrdiff_t>(best) + way;
         i >= 0 && i < static_cast<std::ptrdiff_t>(trials.size()); i += way) {
      const auto& trial = trials[static_cast<std::size_t>(i)];
      if (!trial || trial->found.gain <= 0) continue;
      const double here = TwiceLogLikelihood(*trial, samples);
      lowest = std::min(lowest, here);
      if (here > lowest + kRipple) runner_up = std::min(runner_up, top - here);
    }
  }
  return runner_up;
}

}  // namespace

void ClockOffsetOptions::Check() const {
  if (!(most_s > 0)) throw UsageError("The largest clock offset has to be above 0 s.");
  if (!(averaging_s >= 0)) throw UsageError("The averaging time of a signal is 0 s or more.");
  if (!(least_overlap > 0 && least_overlap <= 1)) {
    throw UsageError(fmt::format(
        "The least overlap of two signals is a share above 0 up to 1; {} is not.", least_overlap));
  }
}

ClockOffset FindClockOffset(const SampledSignal& all_of_ours, const SampledSignal& all_of_theirs,
                            const ClockOffsetOptions& options) {
  options.Check();
  const SampledSignal ours = WithoutDropouts(all_of_ours), theirs = WithoutDropouts(all_of_theirs);
  for (const SampledSignal* signal : {&ours, &theirs}) {
    if (signal->value.size() < kLeastSamples || !Changes(*signal)) {
      throw InputError(fmt::format(
          "the clock offset needs a quantity that changes, with {} values or more on both sides: "
          "give the offset, or record while the speed changes",
          kLeastSamples));
    }
  }
  const double interval = MedianInterval(theirs);
  const Search search(ours, theirs, options.averaging_s > 0 ? options.averaging_s : interval,
                      options.least_overlap);
  const double step = std::max(interval, MedianInterval(ours)) / 2;
  const auto steps = static_cast<std::ptrdiff_t>(std::ceil(options.most_s / step));
  std::vector<std::optional<Trial>> trials;
  std::size_t best = 0;
  for (std::ptrdiff_t k = -steps; k <= steps; ++k) {
    trials.push_back(search.Try(static_cast<double>(k) * step));
    const std::size_t last = trials.size() - 1;
    if (!trials[last] || trials[last]->found.gain <= 0) continue;
    if (!trials[best] || trials[best]->found.gain <= 0 ||
        trials[last]->residual < trials[best]->residual) {
      best = last;
    }
  }
  if (!trials[best] || trials[best]->found.gain <= 0) {
    throw InputError(fmt::format(
        "no clock offset up to {} s lays {:.0f} % of the samples of one signal within the other: "
        "give the offset roughly, or a longer recording",
        options.most_s, 100 * options.least_overlap));
  }
  if (best == 0 || best + 1 == trials.size() || !trials[best - 1] || !trials[best + 1]) {
    throw InputError(
        fmt::format("the clock offset fits best at the end of what was tried, {:.3f} s: it may lie "
                    "beyond; give "
                    "it roughly, or a longer recording",
                    trials[best]->found.offset_s));
  }
  Trial at = *trials[best];
  for (int i = 0; i < 20; ++i) {
    const double by = std::clamp(at.slope_residual / at.information, -step, step);
    const std::optional<Trial> next = search.Try(at.found.offset_s + by);
    if (!next || !(next->residual <= at.residual)) break;
    at = *next;
    if (std::abs(by) < 1e-9) break;
  }
  ClockOffset found = at.found;
  found.sigma_s = std::sqrt(at.residual / at.information);
  found.runner_up = RunnerUp(trials, best, found.samples);
  if (!(found.correlation > kLeastCorrelation)) {
    throw InputError(fmt::format(
        "the signals do not tell the clock offset: at the best one, {:.3f} s, they correlate by "
        "{:.2f} only; record while the speed changes, or give the offset",
        found.offset_s, found.correlation));
  }
  if (found.runner_up < kLikelyAsWell) {
    throw InputError(fmt::format(
        "the signals do not tell the clock offset: {:.3f} s fits best, but another one fits nearly "
        "as well (2 log likelihood differs by {:.1f}), as with periodic signals; give the offset "
        "roughly, or let the speed change once",
        found.offset_s, found.runner_up));
  }
  return found;
}

}  // namespace plumbline
