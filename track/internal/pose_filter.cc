#include "track/internal/pose_filter.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace plumbline::internal {
namespace {

constexpr double kBadShare = 0.01;
constexpr double kAnywhere_rad = 0.35, kAnywhere_mm = 100;
// Rates at the first frame.
constexpr double kRate_rad_s = 0.35, kRate_mm_s = 200;
constexpr double kLeastNoise = 1e-12;

constexpr int kTop = 5, kCommon = 6;

struct Prediction {
  PoseStateCov F = PoseStateCov::Identity(), Q = PoseStateCov::Zero();
  PoseState added = PoseState::Zero();
};

Prediction Predict(const PoseModel& model, const PoseObservation& from, const PoseObservation& to) {
  const double dt_s = std::abs(to.time_s - from.time_s);
  Prediction p;
  p.Q.diagonal().head<kCommon>().array() = kLeastNoise * dt_s;
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
  const PoseObservation& later = to.time_s > from.time_s ? to : from;
  if (later.top && !later.top->as_before) {
    p.F(kTop, kTop) = 0;
    p.Q(kTop, kTop) = model.sigma_obstacle_mm * model.sigma_obstacle_mm;
    p.added[kTop] = model.obstacle_mm;
  }
  return p;
}

// The state's columns: the value, and what each calibration mode does to it.
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
  start.mean(kTop, 0) = model.obstacle_mm;
  start.cov(kTop, kTop) = model.sigma_obstacle_mm * model.sigma_obstacle_mm;
  start.cov.diagonal().tail<kPoseCommon>().setOnes();
  return start;
}

Gaussian Advance(const Gaussian& from, const Prediction& p) {
  Gaussian to{p.F * from.mean, p.F * from.cov * p.F.transpose() + p.Q};
  to.mean.col(0) += p.added;
  return to;
}

struct Innovation {
  Eigen::MatrixXd H, R, S, residual;  // residual: a row an observed number, as the state's columns
};

// What the state makes of a frame's numbers.
Eigen::MatrixXd SeenOf(const PoseObservation& frame) {
  const Eigen::Index n = AnglesAndHeight(frame);
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n + (frame.top ? 1 : 0), kPoseState);
  for (Eigen::Index k = 0; k < n; ++k) H(k, kPlaceOf[k]) = 1;
  for (std::size_t c = 0; c < kPoseCommon; ++c) {
    const auto column = kCommon + static_cast<Eigen::Index>(c);
    H.col(column).head(n) = frame.common[c].head(n);
    if (frame.top) H(n, column) = frame.top->common_mm[c];
  }
  if (!frame.top) return H;
  H(n, kPlaceOf[2]) = 1;
  H(n, kTop) = -1;
  return H;
}

Innovation Innovate(const PoseObservation& frame, const Gaussian& state) {
  const Eigen::Index n = AnglesAndHeight(frame);
  Innovation in;
  in.H = SeenOf(frame);
  in.R = Eigen::MatrixXd::Zero(in.H.rows(), in.H.rows());
  in.R.topLeftCorner(n, n) = frame.cov.topLeftCorner(n, n);
  if (frame.top) {
    in.R.col(n).head(n) = frame.top->cov.head(n);
    in.R.row(n).head(n) = frame.top->cov.head(n).transpose();
    in.R(n, n) = frame.top->cov[3];
  }
  in.S = in.H * state.cov * in.H.transpose() + in.R;
  in.residual = -in.H * state.mean;
  const auto add = [&](Eigen::Index column, const RigPose& pose, double above_top_mm) {
    in.residual.col(column).head(n) += pose.head(n);
    if (frame.top) in.residual(n, column) += above_top_mm;
  };
  add(0, frame.pose, frame.top ? frame.top->below_axis_mm : 0);
  for (Eigen::Index m = 1; m < in.residual.cols(); ++m) {
    const auto mode = static_cast<std::size_t>(m - 1);
    add(m, frame.along_modes[mode], frame.top ? frame.top->along_modes_mm[mode] : 0);
  }
  return in;
}

void Update(const Innovation& in, Gaussian* state) {
  const Eigen::MatrixXd gain = in.S.ldlt().solve(in.H * state->cov).transpose();
  state->mean += gain * in.residual;
  // Joseph's form stays positive.
  const PoseStateCov keep = PoseStateCov::Identity() - gain * in.H;
  state->cov = keep * state->cov * keep.transpose() + gain * in.R * gain.transpose();
}

}  // namespace

int AnglesAndHeight(const PoseObservation& frame) {
  switch (frame.of) {
    case PoseObservation::Of::kPlane:
      return 3;
    case PoseObservation::Of::kTurns:
      return 2;
    case PoseObservation::Of::kPitch:
      return 1;
    default:
      return 0;
  }
}

Eigen::Matrix3d PoseOf(const PoseStateCov& cov) {
  Eigen::Matrix3d of_pose;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) of_pose(i, j) = cov(kPlaceOf[i], kPlaceOf[j]);
  }
  return of_pose;
}

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
    const int n = AnglesAndHeight(frame);
    if (n == 0) continue;
    const Innovation in = Innovate(frame, state);
    const Eigen::LDLT<Eigen::MatrixXd> solver(in.S);
    const Eigen::VectorXd z = in.residual.col(0);
    const double good =
        std::log(1 - kBadShare) - (static_cast<double>(z.size()) * std::log(2 * std::numbers::pi) +
                                   solver.vectorD().array().log().sum() + z.dot(solver.solve(z))) /
                                      2;
    const double heights = (n == 3 ? 1 : 0) + (frame.top ? 1 : 0);
    const double bad = std::log(kBadShare) - std::min(n, 2) * std::log(kAnywhere_rad) -
                       heights * std::log(kAnywhere_mm);
    const double larger = std::max(good, bad);
    result.log_likelihood += larger + std::log(std::exp(good - larger) + std::exp(bad - larger));
    if (good < bad) continue;
    result.taken[at] = 1;
    Update(in, &state);
  }
  return result;
}

double Contradiction(const PoseObservation& frame, const SmoothedPose& smoothed, bool taken) {
  const Eigen::Index n = AnglesAndHeight(frame);
  const Eigen::MatrixXd H = SeenOf(frame).topRows(n);
  const Eigen::VectorXd residual = frame.pose.head(n) - H * smoothed.state;
  const Eigen::MatrixXd R = frame.cov.topLeftCorner(n, n);
  // With its own part taken out of the smoothed state, where that is in it.
  const Eigen::MatrixXd both =
      R + (taken ? -1 : 1) * (H * smoothed.errors.cov * H.transpose()) + 1e-6 * R;
  return residual.dot(both.ldlt().solve(residual));
}

Eigen::Matrix3d PoseWithoutCommon(const PoseStateCov& cov) {
  PoseStateCov without = cov;
  const auto with_common = cov.rightCols<kPoseCommon>();
  without -= with_common * cov.bottomRightCorner<kPoseCommon, kPoseCommon>().ldlt().solve(
                               with_common.transpose());
  return PoseOf(without);
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
      predicted.push_back(Start(model, 1 + modes));
    } else {
      steps.push_back(Predict(model, frames[k - 1], frames[k]));
      predicted.push_back(Advance(filtered.back(), steps.back()));
    }
    filtered.push_back(predicted.back());
    if (taken[k] != 0) Update(Innovate(frames[k], filtered.back()), &filtered.back());
  }
  std::vector<Gaussian> smoothed = filtered;
  std::vector<SmoothedPose> poses(frames.size());
  for (std::size_t k = frames.size(); k-- > 1;) {
    const Gaussian& before = filtered[k - 1];
    const PoseStateCov gain =
        predicted[k].cov.ldlt().solve(steps[k - 1].F * before.cov).transpose();
    smoothed[k - 1].mean = before.mean + gain * (smoothed[k].mean - predicted[k].mean);
    smoothed[k - 1].cov =
        before.cov + gain * (smoothed[k].cov - predicted[k].cov) * gain.transpose();
    poses[k - 1].errors.gain = gain;
  }
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const auto pick = [&](Eigen::Index column) {
      const auto& mean = smoothed[k].mean;
      return RigPose(mean(0, column), mean(2, column), mean(3, column));
    };
    poses[k].pose = pick(0);
    for (Eigen::Index m = 0; m < modes; ++m) poses[k].along_modes.push_back(pick(1 + m));
    poses[k].state = smoothed[k].mean.col(0);
    poses[k].errors.cov = smoothed[k].cov;
    poses[k].cov = PoseOf(smoothed[k].cov);
  }
  return poses;
}

}  // namespace plumbline::internal
