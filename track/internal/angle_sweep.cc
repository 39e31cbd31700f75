#include "track/internal/angle_sweep.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

namespace plumbline::internal {
namespace {

Eigen::Matrix3d Transition(double dt) {
  Eigen::Matrix3d F;
  F << 1, dt, dt * dt / 2, 0, 1, dt, 0, 0, 1;
  return F;
}

// The inverse of the lower triangular root of the noise that a state takes up over a time.
Eigen::Matrix3d WhitenedNoise(double dt, double q) {
  const double dt2 = dt * dt, dt3 = dt2 * dt, dt4 = dt3 * dt, dt5 = dt4 * dt;
  Eigen::Matrix3d Q;
  Q << dt5 / 20, dt4 / 8, dt3 / 6, dt4 / 8, dt3 / 3, dt2 / 2, dt3 / 6, dt2 / 2, dt;
  const Eigen::Matrix3d L = (q * Q).llt().matrixL();
  return L.triangularView<Eigen::Lower>().solve(Eigen::Matrix3d::Identity());
}

// State: angle, speed, acceleration; where the measured angles drift, that too.
template <int N>
class Sweeper {
 public:
  Sweeper(const AngleSeries& series, double q) : series_(series), q_(q) {}

  AngleSweep Run() {
    const std::size_t n = series_.size();
    R_ = Cov::Identity() / std::sqrt(series_.start_variance);
    // All that the angles drift by counts from the first frame.
    if (N > kOfState) R_(N - 1, N - 1) = 1 / std::sqrt(series_.still_variance);
    rhs_ = State::Zero();
    ties_.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      if (std::isfinite(series_.variance[i])) TakeAngle(i);
      ties_[i] = {R_, Cov::Zero(), rhs_};
      if (i + 1 < n) GoOn(i);
    }
    sweep_.innovations = std::max(0, seen_ - kOfState);
    GoBack();
    return std::move(sweep_);
  }

 private:
  using State = Eigen::Matrix<double, N, 1>;
  using Cov = Eigen::Matrix<double, N, N>;
  static constexpr int kOfState = AngleSweep::kOfState;
  struct Tie {
    Cov own, next;  // own x_i + next x_i+1 = rhs
    State rhs;
  };

  static State OfMeasured() {
    State h = State::Zero();
    h[0] = 1;
    if (N > kOfState) h[N - 1] = 1;
    return h;
  }
  template <typename Matrix>
  static double LogDeterminant(const Matrix& triangular) {
    return triangular.diagonal().array().abs().log().sum();
  }
  // left: what the orthogonal transformation leaves of the measurement: its innovation in sigmas.
  void Count(double left, double log_grown, double variance) {
    sweep_.chi2 += left * left;
    sweep_.log_variance += 2 * log_grown + std::log(variance);
    ++seen_;
  }

  void TakeAngle(std::size_t i) {
    const double sigma = std::sqrt(series_.variance[i]);
    Eigen::Matrix<double, N + 1, N + 1> rows;
    rows << R_, rhs_, OfMeasured().transpose() / sigma, series_.value[i] / sigma;
    const auto solved = Eigen::HouseholderQR<decltype(rows)>(rows).matrixQR().eval();
    const Cov R = solved.template topLeftCorner<N, N>().template triangularView<Eigen::Upper>();
    Count(solved(N, N), LogDeterminant(R) - LogDeterminant(R_), series_.variance[i]);
    R_ = R;
    rhs_ = solved.template topRightCorner<N, 1>();
  }

  void GoOn(std::size_t i) {
    const double dt = series_.step[i + 1];
    Cov whiten = Cov::Zero(), F = Cov::Identity();
    whiten.template topLeftCorner<3, 3>() = WhitenedNoise(dt, q_);
    F.template topLeftCorner<3, 3>() = Transition(dt);
    if (N > kOfState) whiten(N - 1, N - 1) = 1 / std::sqrt(series_.drift_variance[i]);
    Eigen::Matrix<double, 2 * N + 1, 2 * N + 1> rows;
    rows.setZero();
    rows.template topLeftCorner<N, N>() = R_;
    rows.template topRightCorner<N, 1>() = rhs_;
    rows.template block<N, N>(N, 0) = -whiten * F;
    rows.template block<N, N>(N, N) = whiten;
    const bool turn = std::isfinite(series_.turn_variance[i]);
    if (turn) {
      const double sigma = std::sqrt(series_.turn_variance[i]);
      rows(2 * N, 0) = -1 / sigma;
      rows(2 * N, N) = 1 / sigma;
      rows(2 * N, 2 * N) = series_.turn[i] / sigma;
    }
    const auto solved = Eigen::HouseholderQR<decltype(rows)>(rows).matrixQR().eval();
    const auto own = solved.template topLeftCorner<2 * N, 2 * N>();
    if (turn) {
      Count(solved(2 * N, 2 * N), LogDeterminant(own) - LogDeterminant(R_) - LogDeterminant(whiten),
            series_.turn_variance[i]);
    }
    ties_[i] = {solved.template topLeftCorner<N, N>().template triangularView<Eigen::Upper>(),
                solved.template block<N, N>(0, N), solved.template block<N, 1>(0, 2 * N)};
    R_ = solved.template block<N, N>(N, N).template triangularView<Eigen::Upper>();
    rhs_ = solved.template block<N, 1>(N, 2 * N);
  }

  void GoBack() {
    const std::size_t n = series_.size();
    sweep_.state.resize(n);
    const State h = OfMeasured();
    State x = State::Zero();
    Cov P = Cov::Zero();
    for (std::size_t i = n; i-- > 0;) {
      const Cov back = ties_[i].own.template triangularView<Eigen::Upper>().solve(Cov::Identity());
      const Cov gain = back * ties_[i].next;
      AngleState& state = sweep_.state[i];
      // Of x_i+1 - x_i = (I + gain) x_i+1 - back (rhs + noise): no large parts are subtracted.
      const Eigen::Matrix<double, 1, N> d = Cov::Identity().row(0) + gain.row(0);
      state.var_turn = d * P * d.transpose() + back.row(0).squaredNorm();
      x = back * (ties_[i].rhs - ties_[i].next * x);
      P = back * back.transpose() + gain * P * gain.transpose();
      state.angle = x[0];
      state.speed = x[1];
      state.var_angle = P(0, 0);
      state.var_speed = P(1, 1);
      state.measured = h.dot(x);
      state.var_measured = h.dot(P * h);
      state.covar_measured = P.row(0).dot(h);
    }
  }

  const AngleSeries& series_;
  double q_;
  Cov R_;
  State rhs_;
  std::vector<Tie> ties_;
  AngleSweep sweep_;
  int seen_ = 0;
};

}  // namespace

AngleSweep SweepAngles(const AngleSeries& series, double q) {
  if (series.size() == 0) return {};
  return series.drift_variance.empty() ? Sweeper<3>(series, q).Run() : Sweeper<4>(series, q).Run();
}

}  // namespace plumbline::internal
