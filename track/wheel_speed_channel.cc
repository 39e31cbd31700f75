#include "track/wheel_speed_channel.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/maximise.h"

namespace plumbline {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kMedianOfNormal = 0.6745;

SampledSignal WithoutDropouts(const WheelSpeedChannel& channel) {
  SampledSignal out;
  for (std::size_t k = 0; k < channel.speed_rad_s.value.size(); ++k) {
    const double time_s = channel.speed_rad_s.time_s[k] - channel.clock_offset_s;
    if (!std::isfinite(channel.speed_rad_s.value[k])) continue;
    if (!out.time_s.empty() && !(time_s > out.time_s.back())) continue;  // the same sample twice
    out.time_s.push_back(time_s);
    out.value.push_back(channel.speed_rad_s.value[k]);
  }
  return out;
}

// How far each sample lies off the line between those beside it, as a sigma of one sample: root
// mean square of those within four sigmas by the median, which many samples tell better than it.
double NoiseOf(const SampledSignal& signal) {
  std::vector<double> off;
  for (std::size_t k = 1; k + 1 < signal.value.size(); ++k) {
    const double share =
        (signal.time_s[k] - signal.time_s[k - 1]) / (signal.time_s[k + 1] - signal.time_s[k - 1]);
    const double between =
        signal.value[k - 1] + share * (signal.value[k + 1] - signal.value[k - 1]);
    off.push_back(std::abs(signal.value[k] - between) /
                  std::sqrt(1 + share * share + (1 - share) * (1 - share)));
  }
  if (off.empty()) return 0;
  constexpr double kFar = 4;
  const double limit = kFar * Median(off) / kMedianOfNormal;
  double squares = 0, count = 0;
  for (const double distance : off) {
    if (distance > limit) continue;
    squares += distance * distance;
    count += 1;
  }
  return std::sqrt(squares / count);
}

double MedianStep(std::span<const double> times) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < times.size(); ++i) steps.push_back(times[i] - times[i - 1]);
  return steps.empty() ? 0 : Median(std::move(steps));
}

// What a turn is made of: samples from `first` on, each with its weight (s). Empty: it is not
// known.
struct Integral {
  std::size_t first = 0;
  std::vector<double> weight_s;
  double speed_change_rad_s = 0;  // from its beginning to its end
};

// Of the lines between samples. Not known where one of them is longer than the longest that is
// allowed, or the signal does not reach.
Integral Integrate(const SampledSignal& signal, double begin_s, double end_s, double longest_s) {
  const std::vector<double>& t = signal.time_s;
  if (t.size() < 2 || !(begin_s >= t.front() && end_s <= t.back())) return {};
  const auto after = std::upper_bound(t.begin() + 1, t.end() - 1, begin_s);
  Integral out;
  out.first = static_cast<std::size_t>(after - t.begin()) - 1;
  out.weight_s.push_back(0);
  const auto value_at = [&](std::size_t k, double share) {
    return signal.value[k] + share * (signal.value[k + 1] - signal.value[k]);
  };
  for (std::size_t k = out.first; k + 1 < t.size() && t[k] < end_s; ++k) {
    const double length = t[k + 1] - t[k];
    if (length > longest_s) return {};
    const double from = (std::max(begin_s, t[k]) - t[k]) / length;
    const double to = (std::min(end_s, t[k + 1]) - t[k]) / length;
    const double middle = (from + to) / 2, part_s = (to - from) * length;
    out.weight_s.back() += (1 - middle) * part_s;
    out.weight_s.push_back(middle * part_s);
    out.speed_change_rad_s += value_at(k, to) - value_at(k, from);
  }
  return out;
}

// Of each sample in all turns together.
std::vector<double> WeightsInAll(const std::vector<Integral>& turns, std::size_t samples) {
  std::vector<double> weights(samples, 0.0);
  for (const Integral& turn : turns) {
    for (std::size_t k = 0; k < turn.weight_s.size(); ++k) {
      weights[turn.first + k] += turn.weight_s[k];
    }
  }
  return weights;
}

// The placed frames of a recording.
std::vector<std::size_t> PlacedFrames(const RollingWheel& rolling) {
  std::vector<std::size_t> placed;
  for (std::size_t f = 0; f < rolling.frames.size(); ++f) {
    if (rolling.frames[f].status == RollingFrameStatus::kPlaced) placed.push_back(f);
  }
  return placed;
}

// One turn from a placed frame to the next, by both.
struct Pair {
  double channel_rad = kNone, images_rad = 0;
  // Without what draws all of the surface along; with it.
  double variance = 0;
  double drift_rad = 0;        // by how far places disagree
  double common_variance = 0;  // of the clock, the scale and the calibration

  bool BothTell() const { return std::isfinite(channel_rad) && std::isfinite(images_rad); }
};

// How far off one another both are, as far as noise does not explain it (maximum likelihood).
double DrawnAlong(const std::vector<Pair>& pairs) {
  constexpr double kLeast = -8, kMost = 0;  // log10 of rad
  const auto likelihood = [&](double drawn) {
    double sum = 0;
    for (const Pair& pair : pairs) {
      if (!pair.BothTell()) continue;
      const double v = pair.variance + drawn * drawn, off = pair.images_rad - pair.channel_rad;
      sum -= (std::log(v) + off * off / v) / 2;
    }
    return sum;
  };
  const double best = std::pow(
      10, internal::Maximise(kLeast, kMost, internal::SearchSteps(), [&](double log_drawn) {
        return likelihood(std::pow(10, log_drawn));
      }));
  return likelihood(best) > likelihood(0) ? best : 0;
}

// What the channel says against the images where they see no obstacle; empty: nothing.
std::string Contradiction(const std::vector<Pair>& pairs, bool steady) {
  constexpr double kSigmas = 3, kDrawnShare = 0.02;
  std::vector<double> drifts;
  for (const Pair& pair : pairs) {
    if (pair.BothTell()) drifts.push_back(pair.drift_rad);
  }
  if (drifts.empty()) return "it does not reach over two frames in a row";
  const double agreed = Median(std::move(drifts));
  std::vector<double> excess, off, turned;
  for (const Pair& pair : pairs) {
    if (!pair.BothTell() || (!steady && pair.drift_rad > agreed)) continue;
    const double allowed = kSigmas * std::sqrt(pair.variance + pair.common_variance) +
                           (steady ? 0 : kDrawnShare * std::abs(pair.images_rad));
    off.push_back(std::abs(pair.images_rad - pair.channel_rad));
    turned.push_back(std::abs(pair.images_rad));
    excess.push_back(off.back() / allowed);
  }
  if (!(Median(std::move(excess)) > 1)) return {};
  constexpr double kDegree = std::numbers::pi / 180;
  return fmt::format(
      "it contradicts the images where these see no obstacle: from frame to frame the turns differ "
      "by {:.2g} of {:.2g} degrees (medians). It is of another wheel, in another unit, or the "
      "clock's offset or what it is told against is wrong",
      Median(std::move(off)) / kDegree, Median(std::move(turned)) / kDegree);
}

// What the channel and the images say from each placed frame to the next, and how to smooth it.
class Leaning {
 public:
  Leaning(const WheelSpeedChannel& channel, std::span<const RigRotationFrame> rotation,
          RollingWheel* rolling)
      : channel_(channel),
        rotation_(rotation),
        rolling_(*rolling),
        placed_(PlacedFrames(*rolling)) {
    for (const std::size_t f : placed_) times_.push_back(rolling_.frames[f].time_s);
  }

  ChannelLean Run(const AngleSmootherOptions& options) {
    ChannelLean out;
    if (placed_.size() < 2) {
      out.problem = "there are no two frames to turn between";
      return out;
    }
    const bool clock =
        std::all_of(times_.begin(), times_.end(), [](double t) { return std::isfinite(t); });
    if (!clock) {
      out.problem = "the frames have no times";
      return out;
    }
    by_channel_ = TurnsByChannel(channel_, times_);
    out.problem = WhatIsMissing();
    if (!out.problem.empty()) return out;
    Compare();
    out.sigma_sample_rad_s = by_channel_.sigma_sample_rad_s;
    out.problem = Contradiction(pairs_, rolling_.deformation.steady);
    if (!out.problem.empty()) return out;
    if (!rolling_.deformation.steady) out.drawn_along_rad = DrawnAlong(pairs_);
    for (const Pair& pair : pairs_) out.gaps += std::isfinite(pair.channel_rad) ? 0 : 1;
    out.used = true;
    Smooth(options, &out);
    return out;
  }

 private:
  std::string WhatIsMissing() const {
    if (!(by_channel_.sigma_sample_rad_s > 0)) {
      return "its samples do not scatter and so do not tell their noise; give its standard "
             "deviation";
    }
    const auto known = [&](std::size_t f) { return rotation_.empty() || rotation_[f].known[0]; };
    if (std::none_of(placed_.begin(), placed_.end(), known)) {
      return "it is told over the ground, and how the rig turns over that is known in no frame";
    }
    return {};
  }

  const RollingFrame& Frame(std::size_t i) const { return rolling_.frames[placed_[i]]; }
  Eigen::Index Modes() const { return rolling_.angle_along_modes_rad.rows(); }
  double AngleAlong(Eigen::Index mode, std::size_t i) const {
    return rolling_.deformation.along_modes(mode, static_cast<Eigen::Index>(placed_[i]));
  }
  // How the ground turns in the rig along a calibration mode.
  double GroundAlong(Eigen::Index mode, std::size_t i) const {
    if (rotation_.empty()) return 0;
    const auto& along = rotation_[placed_[i]].along_modes;
    const auto k = static_cast<std::size_t>(mode);
    return k < along.size() ? along[k][0] : 0;  // none where the pose was given by hand
  }

  void Compare() {
    for (std::size_t i = 0; i + 1 < placed_.size(); ++i) {
      Pair pair;
      const RollingFrame &from = Frame(i), &to = Frame(i + 1);
      pair.images_rad = to.measured_angle_rad - from.measured_angle_rad;
      pair.channel_rad = by_channel_.turn_rad[i];
      double sigma = by_channel_.sigma_rad[i];
      if (!rotation_.empty()) {
        const RigRotationFrame &a = rotation_[placed_[i]], &b = rotation_[placed_[i + 1]];
        pair.channel_rad =
            a.known[0] && b.known[0] ? pair.channel_rad + b.pose[0] - a.pose[0] : kNone;
        if (a.known[0] && b.known[0]) {
          sigma = std::hypot(sigma, SigmaOfTurn(rotation_, placed_[i], placed_[i + 1]));
        }
      }
      sigmas_.push_back(sigma);
      pair.drift_rad = rolling_.deformation.frames[placed_[i + 1]].turn_spread_rad;
      pair.variance = std::pow(from.sigma_measured_rad, 2) + std::pow(to.sigma_measured_rad, 2) +
                      sigma * sigma + pair.drift_rad * pair.drift_rad;
      pair.common_variance = std::pow(by_channel_.along_clock_rad[i], 2) +
                             std::pow(channel_.sigma_scale * by_channel_.turn_rad[i], 2);
      for (Eigen::Index k = 0; k < Modes(); ++k) {
        pair.common_variance += std::pow(
            AngleAlong(k, i + 1) - AngleAlong(k, i) - (GroundAlong(k, i + 1) - GroundAlong(k, i)),
            2);
      }
      pairs_.push_back(pair);
    }
  }

  void Smooth(const AngleSmootherOptions& options, ChannelLean* lean) {
    const std::size_t n = placed_.size();
    const Eigen::Index K = Modes(), pairs = static_cast<Eigen::Index>(n - 1);
    std::vector<double> angles, sigmas;
    const Eigen::MatrixXd& of_reference = rolling_.angle_along_reference_rad;
    Eigen::MatrixXd along(K + of_reference.rows(), static_cast<Eigen::Index>(n));
    for (std::size_t i = 0; i < n; ++i) {
      angles.push_back(Frame(i).measured_angle_rad);
      sigmas.push_back(Frame(i).sigma_measured_rad);
      const auto at = static_cast<Eigen::Index>(i);
      for (Eigen::Index k = 0; k < K; ++k) along(k, at) = AngleAlong(k, i);
      if (of_reference.rows() > 0) {
        along.col(at).tail(of_reference.rows()) =
            of_reference.col(static_cast<Eigen::Index>(placed_[i]));
      }
    }
    AngleTurns turns;
    // The modes of the calibration, the clock, and a factor on the channel of 1 more than it is.
    turns.along_rad.resize(K + 2, pairs);
    for (std::size_t i = 0; i + 1 < n; ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      turns.turn_rad.push_back(pairs_[i].channel_rad);
      turns.sigma_rad.push_back(sigmas_[i]);
      turns.drift_rad.push_back(std::hypot(pairs_[i].drift_rad, lean->drawn_along_rad));
      for (Eigen::Index k = 0; k < K; ++k) {
        turns.along_rad(k, at) = GroundAlong(k, i + 1) - GroundAlong(k, i);
      }
      turns.along_rad.col(at).tail<2>() << by_channel_.along_clock_rad[i], by_channel_.turn_rad[i];
    }
    const SmoothedAngles smooth = SmoothAngles(times_, angles, sigmas, along, options, turns);
    rolling_.jerk_rad_s25 = smooth.jerk_rad_s25;
    rolling_.scatter *= smooth.scatter;
    for (std::size_t i = 0; i < n; ++i) Take(smooth, i, lean);
    const auto turned = [&](std::size_t a, std::size_t b) { return LeanOf(smooth, a, b); };
    lean->lean = turned(0, n - 1);
    for (std::size_t i = 0; i < n; ++i) {
      rolling_.frames[placed_[i]].channel_lean = i == 0 ? turned(0, 1) : turned(i - 1, i);
    }
  }

  double LeanOf(const SmoothedAngles& smooth, std::size_t a, std::size_t b) const {
    const auto factor = smooth.angle_along_turns_rad.row(Modes() + 1);
    const double turned = smooth.frames[b].angle_rad - smooth.frames[a].angle_rad;
    const double by = factor[static_cast<Eigen::Index>(b)] - factor[static_cast<Eigen::Index>(a)];
    constexpr double kStands_rad = 1e-9;
    return std::abs(turned) > kStands_rad ? std::clamp(by / turned, 0.0, 1.0) : kNone;
  }

  void Take(const SmoothedAngles& smooth, std::size_t i, ChannelLean* lean) {
    const Eigen::Index K = Modes(), at = static_cast<Eigen::Index>(i),
                       column = static_cast<Eigen::Index>(placed_[i]);
    RollingFrame& frame = rolling_.frames[placed_[i]];
    const SmoothedAngle& s = smooth.frames[i];
    // Random, but with one cause each: clock, scale, and the errors of the reference.
    const auto common = [&](const Eigen::VectorXd& along, const Eigen::VectorXd& along_turns) {
      return std::hypot(along.tail(along.size() - K).norm(), along_turns[K],
                        channel_.sigma_scale * along_turns[K + 1]);
    };
    const auto turned = [&](const Eigen::MatrixXd& along) -> Eigen::VectorXd {
      return along.col(at) - along.col(0);
    };
    frame.angle_rad = s.angle_rad;
    frame.speed_rad_s = s.speed_rad_s;
    frame.sigma_random_rad =
        std::hypot(s.sigma_angle_rad,
                   common(smooth.angle_along_rad.col(at), smooth.angle_along_turns_rad.col(at)));
    frame.sigma_random_turn_rad =
        std::hypot(s.sigma_turn_rad,
                   common(turned(smooth.angle_along_rad), turned(smooth.angle_along_turns_rad)));
    frame.sigma_random_rad_s = std::hypot(
        s.sigma_speed_rad_s,
        common(smooth.speed_along_rad_s.col(at), smooth.speed_along_turns_rad_s.col(at)));
    frame.lean = s.lean;
    frame.outlier = s.outlier;
    frame.sigma_measured_rad *= smooth.scatter;
    lean->outliers += s.turn_outlier ? 1 : 0;
    if (K == 0) return;
    rolling_.angle_along_modes_rad.col(column) =
        smooth.angle_along_rad.col(at).head(K) + smooth.angle_along_turns_rad.col(at).head(K);
    rolling_.speed_along_modes_rad_s.col(column) =
        smooth.speed_along_rad_s.col(at).head(K) + smooth.speed_along_turns_rad_s.col(at).head(K);
    frame.sigma_calibration_turn_rad =
        (turned(smooth.angle_along_rad).head(K) + turned(smooth.angle_along_turns_rad).head(K))
            .norm();
    frame.sigma_calibration_rad = rolling_.angle_along_modes_rad.col(column).norm();
    frame.sigma_calibration_rad_s = rolling_.speed_along_modes_rad_s.col(column).norm();
  }

  const WheelSpeedChannel& channel_;
  std::span<const RigRotationFrame> rotation_;
  RollingWheel& rolling_;
  std::vector<std::size_t> placed_;
  std::vector<double> times_;
  ChannelTurns by_channel_;
  std::vector<Pair> pairs_;
  std::vector<double> sigmas_;  // of the turns by the channel against the rig
};

}  // namespace

void WheelSpeedChannel::Check() const {
  if (speed_rad_s.time_s.size() != speed_rad_s.value.size()) {
    throw UsageError("A channel has as many times as values.");
  }
  if (!std::isfinite(clock_offset_s) || !(sigma_clock_offset_s >= 0)) {
    throw UsageError("The logger's clock must be known, and its standard deviation 0 or more.");
  }
  if (sigma_rad_s && !(*sigma_rad_s > 0)) {
    throw UsageError("The standard deviation of the wheel's speed by a channel must be above 0.");
  }
  if (!(sigma_scale >= 0 && sigma_scale < 1)) {
    throw UsageError(
        "The standard deviation of the scale of the wheel's speed must be a share from 0 to 1.");
  }
}

ChannelTurns TurnsByChannel(const WheelSpeedChannel& channel, std::span<const double> times_s) {
  channel.Check();
  for (std::size_t i = 0; i < times_s.size(); ++i) {
    if (!std::isfinite(times_s[i]) || (i > 0 && !(times_s[i] > times_s[i - 1]))) {
      throw std::invalid_argument("TurnsByChannel: the times of the frames must grow");
    }
  }
  const SampledSignal signal = WithoutDropouts(channel);
  ChannelTurns out;
  out.sigma_sample_rad_s = channel.sigma_rad_s ? *channel.sigma_rad_s : NoiseOf(signal);
  const double longest_s = MedianStep(times_s);
  std::vector<Integral> integrals;
  for (std::size_t i = 0; i + 1 < times_s.size(); ++i) {
    integrals.push_back(Integrate(signal, times_s[i], times_s[i + 1], longest_s));
  }
  const std::vector<double> weights = WeightsInAll(integrals, signal.value.size());
  for (const Integral& integral : integrals) {
    const bool known = !integral.weight_s.empty();
    double turn = known ? 0 : kNone, squares = turn;
    for (std::size_t k = 0; k < integral.weight_s.size(); ++k) {
      const std::size_t sample = integral.first + k;
      turn += integral.weight_s[k] * signal.value[sample];
      squares += integral.weight_s[k] * weights[sample];
    }
    out.turn_rad.push_back(turn);
    out.sigma_rad.push_back(out.sigma_sample_rad_s * std::sqrt(squares));
    out.along_clock_rad.push_back(integral.speed_change_rad_s * channel.sigma_clock_offset_s);
    out.gaps += known ? 0 : 1;
  }
  return out;
}

SampledSignal WheelSpeedsOf(const RollingWheel& rolling,
                            std::span<const RigRotationFrame> rotation) {
  std::vector<std::size_t> known;
  for (const std::size_t f : PlacedFrames(rolling)) {
    if (!std::isfinite(rolling.frames[f].speed_rad_s)) continue;
    if (rotation.empty() || rotation[f].known[0]) known.push_back(f);
  }
  SampledSignal out;
  for (std::size_t i = 0; i < known.size(); ++i) {
    const RollingFrame& frame = rolling.frames[known[i]];
    double turning_rad_s = 0;  // of the rig
    const std::size_t before = known[i > 0 ? i - 1 : i],
                      after = known[std::min(i + 1, known.size() - 1)];
    if (!rotation.empty() && after > before) {
      turning_rad_s = (rotation[after].pose[0] - rotation[before].pose[0]) /
                      (rolling.frames[after].time_s - rolling.frames[before].time_s);
    }
    out.time_s.push_back(frame.time_s);
    out.value.push_back(frame.speed_rad_s - turning_rad_s);
  }
  return out;
}

ChannelLean LeanOnChannel(const WheelSpeedChannel& channel,
                          std::span<const RigRotationFrame> rotation,
                          const AngleSmootherOptions& options, RollingWheel* rolling) {
  channel.Check();
  if (!rotation.empty() && rotation.size() != rolling->frames.size()) {
    throw std::invalid_argument("LeanOnChannel: there must be one rotation a frame");
  }
  return Leaning(channel, rotation, rolling).Run(options);
}

}  // namespace plumbline
