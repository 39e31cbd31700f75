#include "track/internal/wheel_equations.h"

#include <tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

// Eigenvalues of information matrices over the largest one: below, rounding decides.
constexpr double kUndetermined = 1e-11;

constexpr std::size_t kMostChunks = 16;

}  // namespace

WheelEquations::WheelEquations(const StereoRig& rig, const WheelProblem& problem)
    : rig_(rig), problem_(problem) {
  const std::size_t frames = problem.angles_rad.size();
  core_size_ = WheelAdjustment::kAxis + static_cast<Eigen::Index>(frames);
  seen_.resize(problem.points_mm.size());
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const WheelObservation& o = problem.observations[i];
    const std::string which = "wheel adjustment: observation " + std::to_string(i);
    if (o.frame < 0 || static_cast<std::size_t>(o.frame) >= frames || o.point < 0 ||
        static_cast<std::size_t>(o.point) >= seen_.size()) {
      throw std::invalid_argument(which + " names a frame or a point that is not there");
    }
    const Eigen::LLT<Eigen::Matrix2d> llt(o.cov_px2);
    if (!o.pixel.allFinite() || !o.cov_px2.allFinite() || llt.info() != Eigen::Success) {
      throw std::invalid_argument(which +
                                  " needs a finite pixel and a positive definite covariance");
    }
    whiten_.push_back(llt.matrixL().solve(Eigen::Matrix2d::Identity()));
    seen_[static_cast<std::size_t>(o.point)].push_back(i);
  }
  in_rig_mm_.resize(size());
  rows_.resize(size());
}

// The pixels of the points in the places of the last evaluation.
void WheelEquations::Project(const StereoRig& rig, std::span<Eigen::Vector2d> pixels,
                             std::vector<Eigen::Matrix<double, 2, 3>>* d_pixel_d_rig) const {
  for (const bool right : {false, true}) {
    std::vector<std::size_t> which;
    std::vector<Eigen::Vector3d> points;
    for (std::size_t i = 0; i < size(); ++i) {
      if (problem_.observations[i].right != right) continue;
      which.push_back(i);
      const Eigen::Vector3d& p = in_rig_mm_[i];
      points.push_back(right ? rig.right_from_left * p : p);
    }
    const Camera& camera = right ? rig.right : rig.left;
    std::vector<Eigen::Vector2d> found(which.size());
    std::vector<Eigen::Matrix<double, 2, 3>> J(d_pixel_d_rig != nullptr ? which.size() : 0);
    if (d_pixel_d_rig != nullptr) {
      camera.ProjectWithPointJacobians(points, found, J);
    } else {
      camera.Project(points, found);
    }
    for (std::size_t n = 0; n < which.size(); ++n) {
      pixels[which[n]] = found[n];
      if (d_pixel_d_rig == nullptr) continue;
      (*d_pixel_d_rig)[which[n]] = right ? (J[n] * rig.right_from_left.rotation).eval() : J[n];
    }
  }
}

bool WheelEquations::Evaluate(const WheelAxis& axis, std::span<const double> angles_rad,
                              std::span<const Eigen::Vector3d> points_mm) {
  // Of each frame as the left camera sees it, then as the right one does.
  std::vector<Eigen::Matrix3d> turn, d_turn;
  for (const bool right : {false, true}) {
    for (std::size_t f = 0; f < angles_rad.size(); ++f) {
      const double on_rad = right && !problem_.late_rad.empty() ? problem_.late_rad[f] : 0;
      d_turn.emplace_back();
      turn.push_back(TurnAboutY(angles_rad[f] + on_rad, &d_turn.back()));
    }
  }
  const Eigen::Vector3d away(0, 0, axis.distance_mm);
  const auto of = [](int index) { return static_cast<std::size_t>(index); };
  const auto turn_of = [&](const WheelObservation& o) {
    return of(o.frame) + (o.right ? angles_rad.size() : 0);
  };
  for (std::size_t i = 0; i < size(); ++i) {
    const WheelObservation& o = problem_.observations[i];
    in_rig_mm_[i] = axis.rotation * (turn[turn_of(o)] * points_mm[of(o.point)] + away);
  }
  std::vector<Eigen::Vector2d> pixels(size());
  std::vector<Eigen::Matrix<double, 2, 3>> d_pixel(size());
  Project(rig_, pixels, &d_pixel);
  for (std::size_t i = 0; i < size(); ++i) {
    if (!pixels[i].allFinite()) return false;
    const WheelObservation& o = problem_.observations[i];
    const Eigen::Matrix3d& R = turn[turn_of(o)];
    const Eigen::Vector3d& point = points_mm[of(o.point)];
    const Eigen::Matrix<double, 2, 3> J = whiten_[i] * d_pixel[i] * axis.rotation;
    WheelRow& row = rows_[i];
    row.residual = whiten_[i] * (pixels[i] - o.pixel);
    row.d_axis << -J * Skew(R * point + away), J.col(2);
    row.d_angle = J * d_turn[turn_of(o)] * point;
    row.d_point = J * R;
  }
  return true;
}

std::vector<Eigen::Vector2d> WheelEquations::ChangeFor(const StereoRig& rig) const {
  std::vector<Eigen::Vector2d> pixels(size());
  Project(rig, pixels, nullptr);
  for (std::size_t i = 0; i < size(); ++i) {
    const Eigen::Vector2d before = whiten_[i] * problem_.observations[i].pixel + rows_[i].residual;
    pixels[i] = (whiten_[i] * pixels[i] - before).eval();
  }
  return pixels;
}

std::vector<Eigen::Vector2d> WheelEquations::ChangeForLater(std::span<const double> by_rad) const {
  std::vector<Eigen::Vector2d> change(size(), Eigen::Vector2d::Zero());
  for (std::size_t i = 0; i < size(); ++i) {
    const WheelObservation& o = problem_.observations[i];
    if (o.right) change[i] = by_rad[static_cast<std::size_t>(o.frame)] * rows_[i].d_angle;
  }
  return change;
}

// Calls body(chunk, begin, end) for parts of the points; their number does not depend on threads.
template <typename Body>
void WheelEquations::OverChunks(const Body& body) const {
  constexpr std::size_t kLargestEntries = 8'000'000;  // of all chunks' matrices together
  const auto entries = static_cast<std::size_t>(core_size_ * core_size_);
  const std::size_t chunks = std::clamp<std::size_t>(kLargestEntries / entries, 1, kMostChunks);
  tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t chunk) {
    body(chunk, chunk * seen_.size() / chunks, (chunk + 1) * seen_.size() / chunks);
  });
}

// One point's part of the reduced matrix.
void WheelEquations::Eliminate(std::size_t p, Eigen::MatrixXd& core) {
  constexpr Eigen::Index kAxis = WheelAdjustment::kAxis;
  Eliminated& e = points_[p];
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (const std::size_t i : seen_[p]) {
    information += weights_[i] * rows_[i].d_point.transpose() * rows_[i].d_point;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(information);
  if (!(eigen.eigenvalues()[0] > kUndetermined * eigen.eigenvalues()[2])) return;
  e.determined = true;
  e.own_mm2 = information.llt().solve(Eigen::Matrix3d::Identity());
  for (Eigen::Index k = 0; k < kAxis; ++k) e.core.push_back(k);
  Eigen::Matrix3Xd W = Eigen::Matrix3Xd::Zero(3, kAxis);
  for (const std::size_t i : seen_[p]) {
    const double w = weights_[i];
    if (w == 0) continue;
    const WheelRow& row = rows_[i];
    const Eigen::Index angle = kAxis + problem_.observations[i].frame;
    core.topLeftCorner<kAxis, kAxis>() += w * row.d_axis.transpose() * row.d_axis;
    const Eigen::Vector4d mixed = w * row.d_axis.transpose() * row.d_angle;
    core.block<kAxis, 1>(0, angle) += mixed;
    core.block<1, kAxis>(angle, 0) += mixed.transpose();
    core(angle, angle) += w * row.d_angle.squaredNorm();
    auto at = std::find(e.core.begin() + kAxis, e.core.end(), angle);
    const auto column = static_cast<Eigen::Index>(at - e.core.begin());
    if (at == e.core.end()) {
      e.core.push_back(angle);
      W.conservativeResize(3, W.cols() + 1);
      W.rightCols<1>().setZero();
    }
    W.leftCols<kAxis>() += w * row.d_point.transpose() * row.d_axis;
    W.col(column) += w * row.d_point.transpose() * row.d_angle;
  }
  e.transfer = e.own_mm2 * W;
  const Eigen::MatrixXd update = W.transpose() * e.transfer;
  for (Eigen::Index a = 0; a < update.rows(); ++a) {
    for (Eigen::Index b = 0; b < update.cols(); ++b) {
      core(e.core[static_cast<std::size_t>(a)], e.core[static_cast<std::size_t>(b)]) -=
          update(a, b);
    }
  }
}

void WheelEquations::Reduce(std::span<const double> weights) {
  weights_.assign(weights.begin(), weights.end());
  points_.assign(seen_.size(), {});
  std::vector<Eigen::MatrixXd> parts(kMostChunks);
  OverChunks([&](std::size_t chunk, std::size_t begin, std::size_t end) {
    parts[chunk] = Eigen::MatrixXd::Zero(core_size_, core_size_);
    for (std::size_t p = begin; p < end; ++p) Eliminate(p, parts[chunk]);
  });
  core_ = Eigen::MatrixXd::Zero(core_size_, core_size_);
  for (const Eigen::MatrixXd& part : parts) {
    if (part.size() > 0) core_ += part;
  }
  frame_determined_.assign(problem_.angles_rad.size(), false);
  counted_ = 0;
  for (std::size_t p = 0; p < seen_.size(); ++p) {
    if (!points_[p].determined) continue;
    for (const std::size_t i : seen_[p]) {
      if (weights_[i] == 0) continue;
      ++counted_;
      frame_determined_[static_cast<std::size_t>(problem_.observations[i].frame)] = true;
    }
  }
  Factor();
}

void WheelEquations::Factor() {
  // The first frame that is seen stands still; those without observation are left alone.
  unknowns_ = static_cast<int>(core_size_);
  held_.clear();
  bool has_first = false;
  for (std::size_t f = 0; f < frame_determined_.size(); ++f) {
    if (frame_determined_[f] && has_first) continue;
    has_first = has_first || frame_determined_[f];
    held_.push_back(WheelAdjustment::kAxis + static_cast<Eigen::Index>(f));
  }
  for (const Eigen::Index at : held_) {
    core_.row(at).setZero();
    core_.col(at).setZero();
    core_(at, at) = 1;
    --unknowns_;
  }
  for (const Eliminated& e : points_) unknowns_ += e.determined ? 3 : 0;
  scale_ = core_.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale_.asDiagonal() * core_ * scale_.asDiagonal();
  factor_.compute(scaled);
  if (factor_.info() != Eigen::Success || !(factor_.rcond() > kUndetermined)) {
    throw InputError(
        "the wheel's axis and angles do not follow from what is seen: the wheel turns too little, "
        "or too few points are followed from frame to frame");
  }
}

WheelEquations::Step WheelEquations::Solve(
    const std::function<const Eigen::Vector2d&(std::size_t)>& residual) const {
  Step step;
  step.points.resize(seen_.size(), Eigen::Vector3d::Zero());
  std::vector<Eigen::VectorXd> parts(kMostChunks);
  std::vector<double> decrements(kMostChunks, 0);
  OverChunks([&](std::size_t chunk, std::size_t begin, std::size_t end) {
    Eigen::VectorXd& g = parts[chunk];
    g = Eigen::VectorXd::Zero(core_size_);
    for (std::size_t p = begin; p < end; ++p) {
      const Eliminated& e = points_[p];
      if (!e.determined) continue;
      Eigen::Vector3d gp = Eigen::Vector3d::Zero();
      for (const std::size_t i : seen_[p]) {
        const Eigen::Vector2d r = weights_[i] * residual(i);
        g.head<WheelAdjustment::kAxis>() += rows_[i].d_axis.transpose() * r;
        g[WheelAdjustment::kAxis + problem_.observations[i].frame] += rows_[i].d_angle.dot(r);
        gp += rows_[i].d_point.transpose() * r;
      }
      for (std::size_t k = 0; k < e.core.size(); ++k) {
        g[e.core[k]] -= e.transfer.col(static_cast<Eigen::Index>(k)).dot(gp);
      }
      step.points[p] = -e.own_mm2 * gp;
      decrements[chunk] -= gp.dot(step.points[p]);
    }
  });
  Eigen::VectorXd g = Eigen::VectorXd::Zero(core_size_);
  for (const Eigen::VectorXd& part : parts) {
    if (part.size() > 0) g += part;
  }
  for (const Eigen::Index at : held_) g[at] = 0;
  step.core = -(scale_.asDiagonal() * factor_.solve(scale_.asDiagonal() * g));
  step.decrement = std::accumulate(decrements.begin(), decrements.end(), -g.dot(step.core));
  for (std::size_t p = 0; p < seen_.size(); ++p) {
    const Eliminated& e = points_[p];
    for (std::size_t k = 0; k < e.core.size(); ++k) {
      step.points[p] -= e.transfer.col(static_cast<Eigen::Index>(k)) * step.core[e.core[k]];
    }
  }
  return step;
}

Eigen::MatrixXd WheelEquations::CoreCovariance() const {
  Eigen::MatrixXd cov = scale_.asDiagonal() *
                        factor_.solve(Eigen::MatrixXd::Identity(core_size_, core_size_)) *
                        scale_.asDiagonal();
  for (const Eigen::Index at : held_) {
    cov.row(at).setZero();
    cov.col(at).setZero();
  }
  return cov;
}

Eigen::Matrix3d WheelEquations::PointCovariance(std::size_t p,
                                                const Eigen::MatrixXd& cov_core) const {
  const Eliminated& e = points_[p];
  const auto n = static_cast<Eigen::Index>(e.core.size());
  Eigen::MatrixXd coupled(n, n);
  for (Eigen::Index a = 0; a < n; ++a) {
    for (Eigen::Index b = 0; b < n; ++b) {
      coupled(a, b) =
          cov_core(e.core[static_cast<std::size_t>(a)], e.core[static_cast<std::size_t>(b)]);
    }
  }
  return e.own_mm2 + e.transfer * coupled * e.transfer.transpose();
}

}  // namespace plumbline::internal
