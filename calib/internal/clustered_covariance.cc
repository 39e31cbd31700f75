#include "calib/internal/clustered_covariance.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <vector>

#include "calib/error.h"

namespace plumbline::internal {
namespace {

// Where cameras and target points stand in the reduced parameter vector theta.
struct Layout {
  int left = 0, right = 0, motion = 0;  // first index of each; motion: right_from_left
  int rig_size = 0;
  std::vector<int> target;  // first index by id, -1 if unseen or fixed
  int size = 0;

  Layout(const BoardProblem& p, bool target_free) : target(p.target_mm.size(), -1) {
    right = p.rig.left.parameter_count();
    motion = right + p.rig.right.parameter_count();
    rig_size = size = motion + 6;
    if (!target_free) return;
    std::vector<bool> seen(p.target_mm.size(), false);
    for (const BoardObservation& o : p.observations)
      seen[static_cast<std::size_t>(o.id)] = seen[static_cast<std::size_t>(o.id)] || !o.outlier;
    for (std::size_t id = 0; id < seen.size(); ++id) {
      if (!seen[id]) continue;
      target[id] = size;
      size += 3;
    }
  }
};

// What one pair of photographs says of theta once its board pose is eliminated.
struct PairInformation {
  Eigen::MatrixXd information;  // S_g
  Eigen::VectorXd score;        // gradient of half the chi^2
};

PairInformation Reduce(const BoardProblem& problem, const Layout& layout,
                       const std::vector<const BoardObservation*>& observations) {
  PairInformation out{Eigen::MatrixXd::Zero(layout.size, layout.size),
                      Eigen::VectorXd::Zero(layout.size)};
  Eigen::MatrixXd cross = Eigen::MatrixXd::Zero(layout.size, 6);
  Eigen::Matrix<double, 6, 6> pose = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 1> pose_score = Eigen::Matrix<double, 6, 1>::Zero();
  for (const BoardObservation* o : observations) {
    const ObservationJacobians j = Linearise(problem, *o);
    const double weight = 1 / (problem.Sigma(*o) * problem.Sigma(*o));
    // The observation touches a few stretches of theta.
    struct Stretch {
      int first;
      Eigen::MatrixXd jacobian;
    };
    std::vector<Stretch> stretches = {{o->camera == 0 ? layout.left : layout.right, j.intrinsics}};
    if (o->camera == 1) stretches.push_back({layout.motion, j.right_from_left});
    if (const int t = layout.target[static_cast<std::size_t>(o->id)]; t >= 0)
      stretches.push_back({t, j.target});
    for (const Stretch& a : stretches) {
      const auto na = a.jacobian.cols();
      for (const Stretch& b : stretches) {
        out.information.block(a.first, b.first, na, b.jacobian.cols()) +=
            weight * a.jacobian.transpose() * b.jacobian;
      }
      cross.middleRows(a.first, na) += weight * a.jacobian.transpose() * j.left_from_board;
      out.score.segment(a.first, na) += weight * a.jacobian.transpose() * j.residual_px;
    }
    pose += weight * j.left_from_board.transpose() * j.left_from_board;
    pose_score += weight * j.left_from_board.transpose() * j.residual_px;
  }
  const Eigen::LDLT<Eigen::Matrix<double, 6, 6>> factor(pose);
  out.information -= cross * factor.solve(cross.transpose());
  out.score -= cross * factor.solve(pose_score);
  return out;
}

// Orthonormal directions of theta that move, turn and scale the whole target.
Eigen::MatrixXd SimilarityDirections(const BoardProblem& problem, const Layout& layout) {
  Eigen::MatrixXd directions = Eigen::MatrixXd::Zero(layout.size, 7);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  int count = 0;
  for (std::size_t id = 0; id < layout.target.size(); ++id) {
    if (layout.target[id] < 0) continue;
    centre += problem.target_mm[id];
    ++count;
  }
  centre /= std::max(count, 1);
  for (std::size_t id = 0; id < layout.target.size(); ++id) {
    if (layout.target[id] < 0) continue;
    const Eigen::Vector3d from_centre = problem.target_mm[id] - centre;
    directions.block<3, 3>(layout.target[id], 0).setIdentity();
    directions.block<3, 3>(layout.target[id], 3) = Skew(from_centre);
    directions.block<3, 1>(layout.target[id], 6) = from_centre;
  }
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(directions);
  return qr.householderQ() * Eigen::MatrixXd::Identity(layout.size, 7);
}

// Ledoit-Wolf weight of the identity for the second moment of the columns of y (P x G), and the
// shrunk matrix.
Eigen::MatrixXd Shrink(const Eigen::MatrixXd& y, double* weight) {
  const double G = static_cast<double>(y.cols());
  const double P = static_cast<double>(y.rows());
  const Eigen::MatrixXd W = y * y.transpose() / G;
  const double mu = W.trace() / P;
  const Eigen::MatrixXd identity = mu * Eigen::MatrixXd::Identity(y.rows(), y.rows());
  const double d2 = (W - identity).squaredNorm();
  double b2 = 0;
  for (Eigen::Index g = 0; g < y.cols(); ++g)
    b2 += (y.col(g) * y.col(g).transpose() - W).squaredNorm();
  b2 = std::min(b2 / (G * G), d2);
  *weight = d2 > 0 ? b2 / d2 : 1;
  return *weight * identity + (1 - *weight) * W;
}

}  // namespace

RigCovariance ClusteredCovariance(const BoardProblem& problem, bool target_free,
                                  double target_sigma_mm) {
  const Layout layout(problem, target_free);
  std::vector<std::vector<const BoardObservation*>> by_pair(problem.left_from_board.size());
  for (const BoardObservation& o : problem.observations) {
    if (!o.outlier) by_pair[static_cast<std::size_t>(o.pair)].push_back(&o);
  }
  std::erase_if(by_pair, [](const auto& pair) { return pair.empty(); });
  const std::size_t G = by_pair.size();

  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(layout.size, layout.size);
  std::vector<Eigen::VectorXd> scores(G);
  for (std::size_t g = 0; g < G; ++g) {
    PairInformation pair = Reduce(problem, layout, by_pair[g]);
    S += pair.information;
    scores[g] = std::move(pair.score);
  }
  for (int camera : {0, 1}) {  // splined lenses: the prior of the control points; the core is held
    const Eigen::Index n = problem.spline_anchor[static_cast<std::size_t>(camera)].size();
    if (n == 0) continue;
    const Eigen::Index first = camera == 0 ? layout.left : layout.right;
    S.diagonal().segment(first + kSplineCore, n - kSplineCore).array() +=
        1 / (kSplineSigma * kSplineSigma);
    S.diagonal().segment(first, kSplineCore).array() *= 1e12;
    for (Eigen::VectorXd& score : scores) score.segment(first, kSplineCore).setZero();
  }
  if (target_free) {
    for (int t : layout.target) {
      if (t >= 0) S.diagonal().segment<3>(t).array() += 1 / (target_sigma_mm * target_sigma_mm);
    }
    const Eigen::MatrixXd gauge = SimilarityDirections(problem, layout);
    const double stiff = 1e6 * S.diagonal().tail(layout.size - layout.rig_size).mean();
    S += stiff * gauge * gauge.transpose();
    // What a pair says along held directions moves nothing.
    for (Eigen::VectorXd& score : scores) score -= gauge * (gauge.transpose() * score);
  }
  // Parameters differ in scale by many orders (focal lengths, k3): equilibrate before factoring.
  const Eigen::VectorXd scale = S.diagonal().cwiseSqrt().cwiseMax(1e-300).cwiseInverse();
  const auto equilibrated = [&](const Eigen::MatrixXd& M) -> Eigen::MatrixXd {
    return scale.asDiagonal() * M * scale.asDiagonal();
  };
  const Eigen::LLT<Eigen::MatrixXd> factor(equilibrated(S));
  if (factor.info() != Eigen::Success) {
    throw InputError(
        "the photographs do not determine all camera parameters; add photographs with more tilt, "
        "or use a smaller --model");
  }
  Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(layout.size, layout.rig_size);
  unit.topRows(layout.rig_size).setIdentity();
  const double dof = DegreesOfFreedom(problem, target_free);
  double chi2 = 0;
  const std::vector<Eigen::Vector2d> residuals = Residuals(problem);
  for (std::size_t i = 0; i < residuals.size(); ++i) {
    const BoardObservation& o = problem.observations[i];
    if (!o.outlier) chi2 += residuals[i].squaredNorm() / std::pow(problem.Sigma(o), 2);
  }
  RigCovariance out;
  const auto rig_scale = scale.head(layout.rig_size);
  out.independent = std::max(chi2 / std::max(dof, 1.0), 1e-12) *
                    (rig_scale.asDiagonal() * factor.solve(unit).topRows(layout.rig_size) *
                     rig_scale.asDiagonal());
  out.independent = (0.5 * (out.independent + out.independent.transpose())).eval();

  Eigen::MatrixXd deltas(layout.rig_size, static_cast<Eigen::Index>(G));
  tbb::parallel_for(std::size_t{0}, G, [&](std::size_t g) {
    const Eigen::MatrixXd without = S - Reduce(problem, layout, by_pair[g]).information;
    const Eigen::LDLT<Eigen::MatrixXd> solver(equilibrated(without));
    const Eigen::VectorXd delta = scale.asDiagonal() * solver.solve(scale.asDiagonal() * scores[g]);
    deltas.col(static_cast<Eigen::Index>(g)) = delta.head(layout.rig_size);
  });
  // Whiten, shrink, and back. The sum of squares of the deltas times (G - 1) / G is the jackknife.
  const Eigen::VectorXd sigma = out.independent.diagonal().cwiseSqrt();
  const Eigen::MatrixXd correlation =
      sigma.cwiseInverse().asDiagonal() * out.independent * sigma.cwiseInverse().asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> whitener(correlation);
  const double count = static_cast<double>(G);
  const Eigen::MatrixXd whitened =
      whitener.matrixL().solve(sigma.cwiseInverse().asDiagonal() * deltas) * std::sqrt(count - 1);
  const Eigen::MatrixXd shrunk = Shrink(whitened, &out.shrinkage);
  const Eigen::MatrixXd back = sigma.asDiagonal() * Eigen::MatrixXd(whitener.matrixL());
  out.clustered = back * shrunk * back.transpose();
  return out;
}

}  // namespace plumbline::internal
