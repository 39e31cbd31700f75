#include "track/internal/pose_filter.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <numbers>

namespace plumbline::internal {
namespace {

constexpr double kBadShare = 0.01;
constexpr double kAnywhere_rad = 0.35, kAnywhere_mm = 100;
// Rates at the first frame.
constexpr double kRate_rad_s = 0.35, kRate_mm_s = 200;
constexpr double kLeastNoise = 1e-12;

int Dimensions(const PoseObservation& frame) {
  switch (frame.of) {
    case PoseObservation::Of::kPlane:
      return 3;
    case PoseObservation::Of::kPitch:
      return 1;
    default:
      return 0;
  }
}

// Pitch, roll, height out of the state.
constexpr int kPlaceOf[3] = {0, 2, 3};

struct Prediction {
  PoseStateCov F = PoseStateCov::Identity(), Q = PoseStateCov::Zero();
};

Prediction Predict(const PoseModel& model, const PoseObservation& from, const PoseObservation& to) {
  const double dt_s = std::abs(to.time_s - from.time_s);
  Prediction p;
  p.Q.diagonal().array() = kLeastNoise * dt_s;
  p.Q(2, 2) += model.noise[1] * model.noise[1] * dt_s;
  const auto drive = [&](int at, double noise) {
    const double q = noise * noise;
    if (!model.with_rate) {
      p.Q(at, at) += q * dt_s;
      return;
    }
    p.F(at, at + 1) = dt_s;
    p.Q(at, at) += q * dt_s * dt_s * dt_s / 3;
    p.Q(at, at + 1) += q * dt_s * dt_s / 2;
    p.Q(at + 1, at) += q * dt_s * dt_s / 2;
    p.Q(at + 1, at + 1) += q * dt_s;
  };
  drive(0, model.noise[0]);
  drive(3, model.noise[2]);
  if (from.of != PoseObservation::Of::kPlane || to.of != PoseObservation::Of::kPlane) {
    p.Q(3, 3) += model.unseen_height_mm * model.unseen_height_mm * dt_s;
  }
  return p;
}

// The state's columns: the value, what the common error does to it, and each calibration mode.
using Columns = Eigen::Matrix<double, kPoseState, Eigen::Dynamic>;

struct Gaussian {
  Columns mean;
  PoseStateCov cov;
};

Gaussian Start(const PoseModel& model, Eigen::Index columns) {
  Gaussian start{Columns::Zero(kPoseState, columns), PoseStateCov::Zero()};
  for (int k = 0; k < 3; ++k) {
    start.mean(kPlaceOf[k], 0) = model.prior[k];
    start.cov(kPlaceOf[k], kPlaceOf[k]) = model.prior_sigma[k] * model.prior_sigma[k];
  }
  const double rate_rad_s = model.with_rate ? kRate_rad_s : 1e-9;
  const double rate_mm_s = model.with_rate ? kRate_mm_s : 1e-9;
  start.cov(1, 1) = rate_rad_s * rate_rad_s;
  start.cov(4, 4) = rate_mm_s * rate_mm_s;
  return start;
}

Gaussian Advance(const Gaussian& from, const Prediction& p) {
  return {p.F * from.mean, p.F * from.cov * p.F.transpose() + p.Q};
}

struct Innovation {
  Eigen::Matrix<double, 3, kPoseState> H = Eigen::Matrix<double, 3, kPoseState>::Zero();
  Eigen::MatrixXd R, S, residual;  // residual: n x columns
};

Innovation Innovate(const PoseObservation& frame, const Gaussian& state) {
  const int n = Dimensions(frame);
  Innovation in;
  for (int k = 0; k < n; ++k) in.H(k, kPlaceOf[k]) = 1;
  const auto H = in.H.topRows(n);
  in.R = frame.cov.topLeftCorner(n, n);
  in.S = H * state.cov * H.transpose() + in.R;
  in.residual = -H * state.mean;
  in.residual.col(0) += frame.pose.head(n);
  if (in.residual.cols() > 1) in.residual.col(1) += frame.common.head(n);
  for (Eigen::Index m = 2; m < in.residual.cols(); ++m) {
    in.residual.col(m) += frame.along_modes[static_cast<std::size_t>(m - 2)].head(n);
  }
  return in;
}

void Update(const Innovation& in, Gaussian* state) {
  const auto n = in.S.rows();
  const auto H = in.H.topRows(n);
  const Eigen::MatrixXd gain = in.S.ldlt().solve(H * state->cov).transpose();
  state->mean += gain * in.residual;
  // Joseph's form stays positive.
  const PoseStateCov keep = PoseStateCov::Identity() - gain * H;
  state->cov = keep * state->cov * keep.transpose() + gain * in.R * gain.transpose();
}

}  // namespace

PoseLikelihood LikelihoodOf(std::span<const PoseObservation> frames, const PoseModel& model,
                            bool backwards) {
  PoseLikelihood result;
  result.taken.assign(frames.size(), 0);
  Gaussian state = Start(model, 1);
  for (std::size_t step = 0; step < frames.size(); ++step) {
    const std::size_t at = backwards ? frames.size() - 1 - step : step;
    const PoseObservation& frame = frames[at];
    if (step > 0) {
      const PoseObservation& before = frames[backwards ? at + 1 : at - 1];
      state = Advance(state, Predict(model, before, frame));
    }
    const int n = Dimensions(frame);
    if (n == 0) continue;
    const Innovation in = Innovate(frame, state);
    const Eigen::LDLT<Eigen::MatrixXd> solver(in.S);
    const Eigen::VectorXd z = in.residual.col(0);
    const double good =
        std::log(1 - kBadShare) - (n * std::log(2 * std::numbers::pi) +
                                   solver.vectorD().array().log().sum() + z.dot(solver.solve(z))) /
                                      2;
    const double bad = std::log(kBadShare) - std::log(kAnywhere_rad) -
                       (n == 3 ? std::log(kAnywhere_rad * kAnywhere_mm) : 0);
    const double larger = std::max(good, bad);
    result.log_likelihood += larger + std::log(std::exp(good - larger) + std::exp(bad - larger));
    if (good < bad) continue;
    result.taken[at] = 1;
    Update(in, &state);
  }
  return result;
}

std::vector<SmoothedPose> SmoothPoses(std::span<const PoseObservation> frames,
                                      const std::vector<std::uint8_t>& taken,
                                      const PoseModel& model) {
  Eigen::Index modes = 0;
  for (const PoseObservation& frame : frames) {
    if (frame.of != PoseObservation::Of::kNothing) {
      modes = static_cast<Eigen::Index>(frame.along_modes.size());
    }
  }
  std::vector<Gaussian> predicted, filtered;
  std::vector<Prediction> steps;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    if (k == 0) {
      predicted.push_back(Start(model, 2 + modes));
    } else {
      steps.push_back(Predict(model, frames[k - 1], frames[k]));
      predicted.push_back(Advance(filtered.back(), steps.back()));
    }
    filtered.push_back(predicted.back());
    if (taken[k] != 0) Update(Innovate(frames[k], filtered.back()), &filtered.back());
  }
  std::vector<Gaussian> smoothed = filtered;
  for (std::size_t k = frames.size(); k-- > 1;) {
    const Gaussian& before = filtered[k - 1];
    const PoseStateCov gain =
        predicted[k].cov.ldlt().solve(steps[k - 1].F * before.cov).transpose();
    smoothed[k - 1].mean = before.mean + gain * (smoothed[k].mean - predicted[k].mean);
    smoothed[k - 1].cov =
        before.cov + gain * (smoothed[k].cov - predicted[k].cov) * gain.transpose();
  }
  std::vector<SmoothedPose> poses(frames.size());
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto pick = [&](Eigen::Index column) {
      const auto& mean = smoothed[k].mean;
      return RigPose(mean(0, column), mean(2, column), mean(3, column));
    };
    poses[k].pose = pick(0);
    poses[k].common = pick(1);
    for (Eigen::Index m = 0; m < modes; ++m) poses[k].along_modes.push_back(pick(2 + m));
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        poses[k].cov(i, j) = smoothed[k].cov(kPlaceOf[i], kPlaceOf[j]);
      }
    }
  }
  return poses;
}

}  // namespace plumbline::internal
