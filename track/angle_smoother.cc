#include "track/angle_smoother.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "calib/error.h"
#include "calib/median.h"
#include "track/internal/maximise.h"

namespace plumbline {
namespace {

using State = Eigen::Vector3d;
using Cov = Eigen::Matrix3d;
constexpr int kOfState = 3;  // angles that determine it

// Inside, time is in mean frames, so that all entries of the state are of one size.
struct Series {
  std::vector<double> step;      // to the frame before
  std::vector<double> value;     // less a straight line
  std::vector<double> variance;  // infinite: nothing measured
  double start_variance = 1;     // of the state in the first frame, more than any data say
};

struct Pass {
  std::vector<State> state;
  std::vector<Cov> cov;
  // Of the innovations, where there is one beyond those that determine the state.
  double chi2 = 0, log_variance = 0;
  int innovations = 0;
};

bool Measured(const Series& series, std::size_t i) { return std::isfinite(series.variance[i]); }

Cov Transition(double dt) {
  Cov F;
  F << 1, dt, dt * dt / 2, 0, 1, dt, 0, 0, 1;
  return F;
}

// The inverse of the lower triangular root of the noise that a state takes up over a time.
Cov WhitenedNoise(double dt, double q) {
  const double dt2 = dt * dt, dt3 = dt2 * dt, dt4 = dt3 * dt, dt5 = dt4 * dt;
  Cov Q;
  Q << dt5 / 20, dt4 / 8, dt3 / 6, dt4 / 8, dt3 / 3, dt2 / 2, dt3 / 6, dt2 / 2, dt;
  const Cov L = (q * Q).llt().matrixL();
  return L.triangularView<Eigen::Lower>().solve(Cov::Identity());
}

// Least squares over all states at once, frame by frame: by orthogonal transformations of what is
// known of a state (R x = rhs, unit noise), its measurement and its tie to the next one, then back
// (Paige and Saunders, "Least squares estimation of discrete linear dynamic systems using
// orthogonal transformations", SIAM J. Numer. Anal. 14(2), 1977). No covariance is subtracted from
// another, however little or much is known.
Pass Smooth(const Series& series, double q) {
  const std::size_t n = series.value.size();
  struct Tie {
    Cov own, next;  // own x_i + next x_i+1 = rhs
    State rhs;
  };
  std::vector<Tie> ties(n);
  Pass pass;
  Cov R = Cov::Identity() / std::sqrt(series.start_variance);
  State rhs = State::Zero();
  int seen = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (Measured(series, i)) {
      const double sigma = std::sqrt(series.variance[i]);
      if (++seen > kOfState) {
        const State u = R.transpose().triangularView<Eigen::Lower>().solve(State::UnitX());
        const State x = R.triangularView<Eigen::Upper>().solve(rhs);
        const double S = u.squaredNorm() + series.variance[i];
        pass.chi2 += (series.value[i] - x[0]) * (series.value[i] - x[0]) / S;
        pass.log_variance += std::log(S);
        ++pass.innovations;
      }
      Eigen::Matrix4d rows;
      rows << R, rhs, 1 / sigma, 0, 0, series.value[i] / sigma;
      const Eigen::Matrix4d solved = Eigen::HouseholderQR<Eigen::Matrix4d>(rows).matrixQR();
      R = solved.topLeftCorner<3, 3>().triangularView<Eigen::Upper>();
      rhs = solved.topRightCorner<3, 1>();
    }
    ties[i] = {R, Cov::Zero(), rhs};
    if (i + 1 == n) break;
    const Cov whiten = WhitenedNoise(series.step[i + 1], q);
    Eigen::Matrix<double, 6, 7> rows;
    rows << R, Cov::Zero(), rhs, -whiten * Transition(series.step[i + 1]), whiten, State::Zero();
    const Eigen::Matrix<double, 6, 7> solved =
        Eigen::HouseholderQR<Eigen::Matrix<double, 6, 7>>(rows).matrixQR();
    ties[i] = {solved.topLeftCorner<3, 3>().triangularView<Eigen::Upper>(),
               solved.block<3, 3>(0, 3), solved.block<3, 1>(0, 6)};
    R = solved.block<3, 3>(3, 3).triangularView<Eigen::Upper>();
    rhs = solved.block<3, 1>(3, 6);
  }
  pass.state.resize(n);
  pass.cov.resize(n);
  State later = State::Zero();
  Cov later_cov = Cov::Zero();
  for (std::size_t i = n; i-- > 0;) {
    const Cov back = ties[i].own.triangularView<Eigen::Upper>().solve(Cov::Identity());
    later = back * (ties[i].rhs - ties[i].next * later);
    const Cov inner = Cov::Identity() + ties[i].next * later_cov * ties[i].next.transpose();
    later_cov = back * inner * back.transpose();
    pass.state[i] = later;
    pass.cov[i] = later_cov;
  }
  return pass;
}

// What the other frames say against a frame, in its sigmas: (z - x) / sqrt(R - P).
double LeftOut(const Series& series, const Pass& pass, std::size_t i, double* variance) {
  const double R = series.variance[i], P = std::min(pass.cov[i](0, 0), R * (1 - 1e-9));
  *variance = R * R / (R - P);  // of z less what the others alone say
  return (series.value[i] - pass.state[i][0]) / std::sqrt(R - P);
}

// log10 of q over the angles' median variance: from no change of acceleration to no smoothing.
constexpr double kLowest = -9, kHighest = 5;

double MedianVariance(const Series& series) {
  std::vector<double> finite;
  for (const double v : series.variance) {
    if (std::isfinite(v)) finite.push_back(v);
  }
  return finite.empty() ? 1 : Median(std::move(finite));
}

double RobustNoise(const Series& series) {
  const double unit = MedianVariance(series);
  return unit *
         std::pow(
             10, internal::Maximise(kLowest, kHighest, internal::SearchSteps(), [&](double log_q) {
               const Pass pass = Smooth(series, unit * std::pow(10, log_q));
               double sum = 0;
               constexpr double kFreedom = 4;
               for (std::size_t i = 0; i < series.value.size(); ++i) {
                 if (!Measured(series, i)) continue;
                 double variance = 0;
                 const double t = LeftOut(series, pass, i, &variance);
                 sum -= (kFreedom + 1) / 2 * std::log1p(t * t / kFreedom) + std::log(variance) / 2;
               }
               return sum;
             }));
}

double ScatterOf(const Pass& pass) {
  if (pass.innovations + kOfState < SmoothedAngles::kEnoughForScatter) return 1;
  return std::sqrt(std::max(1.0, pass.chi2 / pass.innovations));
}

double LikelyNoise(const Series& series) {
  const double unit = MedianVariance(series);
  return unit * std::pow(10, internal::Maximise(
                                 kLowest, kHighest, internal::SearchSteps(), [&](double log_q) {
                                   const Pass pass = Smooth(series, unit * std::pow(10, log_q));
                                   const double scatter = ScatterOf(pass);
                                   return -(pass.chi2 / (scatter * scatter) + pass.log_variance +
                                            2 * pass.innovations * std::log(scatter)) /
                                          2;
                                 }));
}

// Marks what the others contradict, the worst first.
void FindOutliers(Series& series, const std::optional<double>& q, double most_sigmas,
                  std::vector<SmoothedAngle>& frames) {
  constexpr int kFewest = 6;  // that can outvote one
  auto left = std::count_if(series.variance.begin(), series.variance.end(),
                            [](double v) { return std::isfinite(v); });
  while (left >= kFewest) {
    const Pass pass = Smooth(series, q ? *q : RobustNoise(series));
    std::vector<double> off(series.value.size(), 0), finite;
    for (std::size_t i = 0; i < off.size(); ++i) {
      if (!Measured(series, i)) continue;
      double variance = 0;
      off[i] = std::abs(LeftOut(series, pass, i, &variance));
      finite.push_back(off[i]);
    }
    constexpr double kMedianOfNormal = 0.6745;
    const double scatter = std::max(1.0, Median(std::move(finite)) / kMedianOfNormal);
    const auto worst = std::max_element(off.begin(), off.end());
    if (!(*worst > most_sigmas * scatter)) return;
    const auto at = static_cast<std::size_t>(worst - off.begin());
    series.variance[at] = std::numeric_limits<double>::infinity();
    frames[at].outlier = true;
    --left;
  }
}

// Frames that are left out in a row do not err independently of each other: rather the motion has
// changed, which a noise that suits the rest does not allow. They count again where under the
// likeliest noise with them nothing contradicts them.
void TakeBackRuns(Series& series, double most_sigmas, std::vector<SmoothedAngle>& frames,
                  const std::vector<double>& variances) {
  constexpr std::size_t kRun = 3;
  Series with = series;
  std::vector<std::size_t> run, taken;
  for (std::size_t i = 0; i <= frames.size(); ++i) {
    if (i < frames.size() && !std::isfinite(variances[i])) continue;
    if (i < frames.size() && frames[i].outlier) {
      run.push_back(i);
      continue;
    }
    if (run.size() >= kRun) taken.insert(taken.end(), run.begin(), run.end());
    run.clear();
  }
  if (taken.empty()) return;
  for (const std::size_t i : taken) with.variance[i] = variances[i];
  std::vector<SmoothedAngle> again(frames.size());
  Series checked = with;
  FindOutliers(checked, LikelyNoise(with), most_sigmas, again);
  const bool holds =
      std::none_of(again.begin(), again.end(), [](const auto& f) { return f.outlier; });
  if (!holds) return;
  series = std::move(with);
  for (const std::size_t i : taken) frames[i].outlier = false;
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
void SetStart(Series& series) {
  constexpr double kVague = 1e4, kRoom = 100;
  double sigma = 0, farthest = 0;
  for (std::size_t i = 0; i < series.value.size(); ++i) {
    if (!Measured(series, i)) continue;
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

}  // namespace

void AngleSmootherOptions::Check() const {
  if (jerk_rad_s25 && !(*jerk_rad_s25 >= 0)) {
    throw UsageError("The noise of the wheel's jerk must not be negative.");
  }
  if (!(outlier_sigmas > 0)) throw UsageError("An outlier must be off by more than 0 sigmas.");
}

SmoothedAngles SmoothAngles(std::span<const double> times_s, std::span<const double> angles_rad,
                            std::span<const double> sigmas_rad, const Eigen::MatrixXd& along,
                            const AngleSmootherOptions& options) {
  options.Check();
  CheckInput(times_s, angles_rad, sigmas_rad, along);
  SmoothedAngles out;
  const std::size_t n = times_s.size();
  out.frames.resize(n);
  out.angle_along_rad = out.speed_along_rad_s =
      Eigen::MatrixXd::Zero(along.rows(), static_cast<Eigen::Index>(n));
  if (n == 0) return out;
  const double frame_s =
      n > 1 ? (times_s.back() - times_s.front()) / static_cast<double>(n - 1) : 1;
  std::vector<double> t;
  for (const double s : times_s) t.push_back((s - times_s.front()) / frame_s);
  const Line line = LineThrough(t, angles_rad);
  Series series;
  for (std::size_t i = 0; i < n; ++i) {
    const bool measured = std::isfinite(angles_rad[i]);
    series.step.push_back(i > 0 ? t[i] - t[i - 1] : 0);
    series.value.push_back(measured ? angles_rad[i] - line.at_0 - line.slope * t[i] : 0);
    series.variance.push_back(measured ? sigmas_rad[i] * sigmas_rad[i]
                                       : std::numeric_limits<double>::infinity());
  }
  SetStart(series);
  const double per_frame = std::pow(frame_s, 5);  // rad^2 / s^5 to rad^2 / frame^5
  std::optional<double> q;
  if (options.jerk_rad_s25) {
    q = std::max(*options.jerk_rad_s25 * *options.jerk_rad_s25 * per_frame,
                 std::pow(10, kLowest) * MedianVariance(series));
  }
  const std::vector<double> variances = series.variance;
  FindOutliers(series, q, options.outlier_sigmas, out.frames);
  if (!q) TakeBackRuns(series, options.outlier_sigmas, out.frames, variances);
  if (!q) q = LikelyNoise(series);
  out.scatter = ScatterOf(Smooth(series, *q));
  for (double& v : series.variance) v *= out.scatter * out.scatter;
  if (!options.jerk_rad_s25) *q *= out.scatter * out.scatter;
  out.jerk_rad_s25 = std::sqrt(*q / per_frame);
  const Pass pass = Smooth(series, *q);
  for (std::size_t i = 0; i < n; ++i) {
    SmoothedAngle& frame = out.frames[i];
    frame.angle_rad = line.at_0 + line.slope * t[i] + pass.state[i][0];
    frame.speed_rad_s = (line.slope + pass.state[i][1]) / frame_s;
    frame.sigma_angle_rad = std::sqrt(std::max(0.0, pass.cov[i](0, 0)));
    frame.sigma_speed_rad_s = std::sqrt(std::max(0.0, pass.cov[i](1, 1))) / frame_s;
    if (!Measured(series, i)) continue;
    frame.lean = std::clamp(1 - pass.cov[i](0, 0) / series.variance[i], 0.0, 1.0);
  }
  for (Eigen::Index k = 0; k < along.rows(); ++k) {
    for (std::size_t i = 0; i < n; ++i) {
      const double change = along(k, static_cast<Eigen::Index>(i));
      series.value[i] = std::isfinite(change) ? change : 0;
    }
    const Pass moved = Smooth(series, *q);
    for (std::size_t i = 0; i < n; ++i) {
      out.angle_along_rad(k, static_cast<Eigen::Index>(i)) = moved.state[i][0];
      out.speed_along_rad_s(k, static_cast<Eigen::Index>(i)) = moved.state[i][1] / frame_s;
    }
  }
  return out;
}

}  // namespace plumbline
