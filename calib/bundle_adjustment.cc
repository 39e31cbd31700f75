#include "calib/bundle_adjustment.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>

#include "calib/error.h"
#include "calib/internal/bundle_information.h"

namespace plumbline {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Information = BundleResult::Information;

[[noreturn]] void Refuse(const std::string& what) {
  throw std::invalid_argument("bundle adjustment: " + what);
}

void CheckProblem(const BundleProblem& problem) {
  const auto in = [](int index, std::size_t size) {
    return index >= 0 && static_cast<std::size_t>(index) < size;
  };
  for (const BundlePoint& p : problem.points) {
    if (!p.point_mm.allFinite()) Refuse("a point is not finite");
  }
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const BundleObservation& o = problem.observations[i];
    const std::string which = "observation " + std::to_string(i);
    if (!in(o.camera, problem.cameras.size()) || !in(o.point, problem.points.size())) {
      Refuse(which + " names a camera or a point that is not there");
    }
    for (const int m : {o.camera_from_rig, o.rig_from_frame}) {
      if (m != -1 && !in(m, problem.motions.size())) {
        Refuse(which + " names a motion that is not there");
      }
    }
    if (o.camera_from_rig >= 0 && o.camera_from_rig == o.rig_from_frame) {
      Refuse(which + " uses one motion twice");
    }
    const bool symmetric = std::abs(o.cov_px2(0, 1) - o.cov_px2(1, 0)) <= 1e-9 * o.cov_px2.norm();
    if (!o.pixel.allFinite() || !o.cov_px2.allFinite() || !symmetric ||
        !(o.cov_px2(0, 0) > 0 && o.cov_px2.determinant() > 0)) {
      Refuse(which + " needs a finite pixel and a positive definite covariance");
    }
  }
  for (const KnownDistance& d : problem.distances) {
    if (!in(d.point_a, problem.points.size()) || !in(d.point_b, problem.points.size()) ||
        d.point_a == d.point_b || !(d.distance_mm > 0 && d.sigma_mm > 0)) {
      Refuse("a known distance needs two points that are there, and a positive length and sigma");
    }
  }
}

// The values that Ceres moves. The lens formulas want a Camera, built once a step.
class State : public ceres::EvaluationCallback {
 public:
  explicit State(const BundleProblem& problem) {
    for (const BundleCamera& c : problem.cameras) {
      intrinsics.push_back(c.camera.parameters());
      cameras.push_back(c.camera);
    }
    for (const BundleMotion& m : problem.motions) {
      motions.emplace_back();
      motions.back() << m.motion.RotationVector(), m.motion.translation_mm;
    }
    for (const BundlePoint& p : problem.points) points.push_back(p.point_mm);
  }

  void PrepareForEvaluation(bool, bool new_point) override {
    if (new_point) Update();
  }
  void Update() {
    valid = true;
    for (std::size_t k = 0; k < cameras.size(); ++k) {
      const Eigen::VectorXd& p = intrinsics[k];
      if (p == cameras[k].parameters()) continue;
      if (p.allFinite() && p[0] > 0 && p[1] > 0) {
        cameras[k] = cameras[k].WithParameters(p);
      } else {
        valid = false;  // the step is refused
      }
    }
  }

  std::vector<Eigen::VectorXd> intrinsics;
  std::vector<Vector6d> motions;
  std::vector<Eigen::Vector3d> points;
  std::vector<Camera> cameras;
  bool valid = true;
};

// Residual of one observation in sigmas. Blocks: intrinsics, motions of the chain (outer first),
// point.
class ObservationCost : public ceres::CostFunction {
 public:
  ObservationCost(const State& state, const BundleObservation& o) : state_(state), o_(o) {
    set_num_residuals(2);
    const Eigen::Matrix2d L = o.cov_px2.llt().matrixL();
    whiten_ = L.inverse();
    const auto c = static_cast<std::size_t>(o.camera);
    mutable_parameter_block_sizes()->push_back(
        static_cast<std::int32_t>(state.intrinsics[c].size()));
    for (const int m : {o.camera_from_rig, o.rig_from_frame}) {
      if (m >= 0) mutable_parameter_block_sizes()->push_back(6);
    }
    mutable_parameter_block_sizes()->push_back(3);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!state_.valid) return false;
    const std::size_t chain = parameter_block_sizes().size() - 2;
    // From the point outwards: before[k] enters motion k, after it comes the next one out.
    std::array<Eigen::Matrix3d, 2> R;
    std::array<std::array<Eigen::Matrix3d, 3>, 2> dR;
    std::array<Eigen::Vector3d, 2> before;
    Eigen::Vector3d p = Eigen::Map<const Eigen::Vector3d>(parameters[chain + 1]);
    for (std::size_t k = chain; k-- > 0;) {
      const Eigen::Map<const Vector6d> motion(parameters[1 + k]);
      R[k] = RotationFromVector(motion.head<3>(), dR[k].data());
      before[k] = p;
      p = R[k] * p + motion.tail<3>();
    }
    const Camera& camera = state_.cameras[static_cast<std::size_t>(o_.camera)];
    const Camera::Projection at = camera.ProjectWithJacobians(p);
    if (!at.pixel.allFinite()) return false;
    Eigen::Map<Eigen::Vector2d>(residuals, 2) = whiten_ * (at.pixel - o_.pixel);
    if (jacobians == nullptr) return true;
    const auto put = [&](std::size_t block, const Eigen::MatrixXd& J) {
      if (jacobians[block] != nullptr) {
        Eigen::Map<RowMajor>(jacobians[block], 2, J.cols()) = whiten_ * J;
      }
    };
    put(0, at.d_pixel_d_parameters);
    Eigen::Matrix<double, 2, 3> d_out = at.d_pixel_d_point;
    for (std::size_t k = 0; k < chain; ++k) {
      Eigen::Matrix<double, 2, 6> J;
      for (int i = 0; i < 3; ++i) J.col(i) = d_out * dR[k][static_cast<std::size_t>(i)] * before[k];
      J.rightCols<3>() = d_out;
      put(1 + k, J);
      d_out = (d_out * R[k]).eval();
    }
    put(chain + 1, d_out);
    return true;
  }

 private:
  const State& state_;
  const BundleObservation& o_;
  Eigen::Matrix2d whiten_;
};

class DistanceCost : public ceres::SizedCostFunction<1, 3, 3> {
 public:
  explicit DistanceCost(const KnownDistance& d) : d_(d) {}
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Vector3d difference = Eigen::Map<const Eigen::Vector3d>(parameters[0]) -
                                       Eigen::Map<const Eigen::Vector3d>(parameters[1]);
    const double length = difference.norm();
    if (!(length > 0)) return false;
    residuals[0] = (length - d_.distance_mm) / d_.sigma_mm;
    if (jacobians == nullptr) return true;
    const Eigen::Vector3d J = difference / (length * d_.sigma_mm);
    if (jacobians[0] != nullptr) Eigen::Map<Eigen::Vector3d>(jacobians[0], 3) = J;
    if (jacobians[1] != nullptr) Eigen::Map<Eigen::Vector3d>(jacobians[1], 3) = -J;
    return true;
  }

 private:
  KnownDistance d_;
};

// Rows A (x - x0): the minimal prior on the gauge.
class GaugeCost : public ceres::CostFunction {
 public:
  GaugeCost(std::vector<Eigen::MatrixXd> A, std::vector<Eigen::VectorXd> x0)
      : A_(std::move(A)), x0_(std::move(x0)) {
    set_num_residuals(static_cast<int>(A_[0].rows()));
    for (const Eigen::MatrixXd& a : A_) {
      mutable_parameter_block_sizes()->push_back(static_cast<std::int32_t>(a.cols()));
    }
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    Eigen::VectorXd r = Eigen::VectorXd::Zero(num_residuals());
    for (std::size_t k = 0; k < A_.size(); ++k) {
      r += A_[k] * (Eigen::Map<const Eigen::VectorXd>(parameters[k], A_[k].cols()) - x0_[k]);
      if (jacobians != nullptr && jacobians[k] != nullptr) {
        Eigen::Map<RowMajor>(jacobians[k], A_[k].rows(), A_[k].cols()) = A_[k];
      }
    }
    Eigen::Map<Eigen::VectorXd>(residuals, r.size()) = r;
    return true;
  }

 private:
  std::vector<Eigen::MatrixXd> A_;
  std::vector<Eigen::VectorXd> x0_;
};

// Weight of a residual of s = |r|^2 sigmas^2: the derivative of the loss.
double Weight(const BundleOptions& options, double s) {
  const double a2 = options.loss_scale_sigmas * options.loss_scale_sigmas;
  if (options.loss == BundleLoss::kHuber) return s <= a2 ? 1.0 : std::sqrt(a2 / s);
  if (options.loss == BundleLoss::kCauchy) return 1.0 / (1.0 + s / a2);
  return 1.0;
}

ceres::LossFunction* MakeLoss(const BundleOptions& options) {
  if (options.loss == BundleLoss::kHuber) return new ceres::HuberLoss(options.loss_scale_sigmas);
  if (options.loss == BundleLoss::kCauchy) return new ceres::CauchyLoss(options.loss_scale_sigmas);
  return nullptr;
}

class Adjustment {
 public:
  Adjustment(const BundleProblem& problem, const BundleOptions& options)
      : problem_(problem), options_(options), state_(problem) {}

  BundleResult Run() {
    auto information = Linearise(nullptr);
    information->Reduce();
    HoldGauge(*information);
    BundleResult out;
    out.solved = problem_;
    Solve(out);
    CopyBack(out);
    auto final_information = Linearise(&out);
    final_information->Reduce();
    if (gauge_.size() > 0) final_information->reduced += gauge_.transpose() * gauge_;
    CheckDetermined(*final_information, final_information->Undetermined());
    final_information->Invert();
    final_information->sigma0 = out.sigma0;
    out.information = final_information;
    return out;
  }

 private:
  std::vector<double*> BlocksOf(const BundleObservation& o) {
    std::vector<double*> blocks = {state_.intrinsics[static_cast<std::size_t>(o.camera)].data()};
    for (const int m : {o.camera_from_rig, o.rig_from_frame}) {
      if (m >= 0) blocks.push_back(state_.motions[static_cast<std::size_t>(m)].data());
    }
    blocks.push_back(state_.points[static_cast<std::size_t>(o.point)].data());
    return blocks;
  }

  // The normal equations here; with a result, also its residuals, weights and sigma0.
  std::shared_ptr<Information> Linearise(BundleResult* out) {
    state_.Update();
    auto information = std::make_shared<Information>(problem_);
    double sum = 0;
    for (std::size_t i = 0; i < problem_.observations.size(); ++i) {
      const BundleObservation& o = problem_.observations[i];
      const ObservationCost cost(state_, o);
      const auto blocks = BlocksOf(o);
      std::vector<RowMajor> J;
      std::vector<double*> J_data;
      for (const auto size : cost.parameter_block_sizes()) J.emplace_back(RowMajor::Zero(2, size));
      for (RowMajor& j : J) J_data.push_back(j.data());
      Eigen::Vector2d r;
      if (!cost.Evaluate(blocks.data(), r.data(), J_data.data())) {
        throw InputError("bundle adjustment: observation " + std::to_string(i) + " (point " +
                         std::to_string(o.point) + ") is not in front of camera " +
                         std::to_string(o.camera) + "; give better starting values or drop it");
      }
      const double weight = out != nullptr ? Weight(options_, r.squaredNorm()) : 1.0;
      if (out != nullptr) {
        out->weights.push_back(weight);
        const Eigen::Matrix2d L = o.cov_px2.llt().matrixL();
        out->residuals_px.emplace_back(L * r);
        sum += weight * r.squaredNorm();
      }
      AddTerms(*information, o, J, std::sqrt(weight));
    }
    sum += AddDistances(*information);
    if (out != nullptr) FinishStatistics(*information, sum, *out);
    return information;
  }

  static void AddTerms(Information& information, const BundleObservation& o,
                       const std::vector<RowMajor>& J, double scale) {
    std::vector<Information::Term> terms;
    const auto add = [&](int start, const RowMajor& j) {
      if (start >= 0) terms.push_back({start, scale * j});
    };
    std::size_t b = 0;
    add(information.camera_start[static_cast<std::size_t>(o.camera)], J[b++]);
    for (const int m : {o.camera_from_rig, o.rig_from_frame}) {
      if (m >= 0) add(information.motion_start[static_cast<std::size_t>(m)], J[b++]);
    }
    if (information.IsEliminated(o.point)) {
      terms.push_back({-1, scale * J[b]});
    } else {
      add(information.point_start[static_cast<std::size_t>(o.point)], J[b]);
    }
    information.Add(terms, o.point);
  }

  double AddDistances(Information& information) {
    double sum = 0;
    for (const KnownDistance& d : problem_.distances) {
      const DistanceCost cost(d);
      const auto a = static_cast<std::size_t>(d.point_a), b = static_cast<std::size_t>(d.point_b);
      const double* const blocks[] = {state_.points[a].data(), state_.points[b].data()};
      Eigen::RowVector3d Ja, Jb;
      double* J[] = {Ja.data(), Jb.data()};
      double r = 0;
      if (!cost.Evaluate(blocks, &r, J)) Refuse("two points of a known distance coincide");
      sum += r * r;
      std::vector<Information::Term> terms;
      if (information.point_start[a] >= 0) terms.push_back({information.point_start[a], Ja});
      if (information.point_start[b] >= 0) terms.push_back({information.point_start[b], Jb});
      information.Add(terms, d.point_a);
    }
    return sum;
  }

  void FinishStatistics(const Information& information, double sum, BundleResult& out) const {
    int unknowns = information.core_size;
    for (std::size_t p = 0; p < problem_.points.size(); ++p) {
      if (information.IsEliminated(static_cast<int>(p))) unknowns += 3;
    }
    out.gauge_directions = static_cast<int>(gauge_.rows());
    out.degrees_of_freedom =
        static_cast<int>(2 * problem_.observations.size() + problem_.distances.size()) - unknowns +
        out.gauge_directions;
    out.sigma0 = out.degrees_of_freedom > 0 ? std::sqrt(sum / out.degrees_of_freedom) : 0.0;
  }

  static void CheckDetermined(const Information& information,
                              const Information::NullSpace& undetermined) {
    if (undetermined.scaled.cols() == 0) return;
    // The entries that take part most, each name once.
    const Eigen::VectorXd share = undetermined.scaled.rowwise().norm();
    std::string names;
    int named = 0;
    for (int i = 0; i < information.core_size; ++i) {
      const std::string name = information.NameOf(i);
      if (share[i] < 0.1 || names.find(name) != std::string::npos) continue;
      if (++named <= 6) names += (names.empty() ? "" : ", ") + name;
    }
    if (named > 6) names += " and " + std::to_string(named - 6) + " more";
    throw InputError("bundle adjustment: " + std::to_string(undetermined.scaled.cols()) +
                     " directions are not constrained; they move " + names +
                     "; hold some of these fixed, add a known distance, or ask for the minimal "
                     "prior if only the common frame and scale are free");
  }

  void HoldGauge(const Information& information) {
    const Information::NullSpace free = information.Undetermined();
    if (free.scaled.cols() == 0) return;
    if (options_.gauge == BundleGauge::kAsGiven) CheckDetermined(information, free);
    for (std::size_t k = 0; k < problem_.cameras.size(); ++k) {
      const int start = information.camera_start[k];
      if (start >= 0 && free.scaled.middleRows(start, information.camera_size[k]).norm() > 1e-4) {
        CheckDetermined(information, free);
      }
    }
    // 7 of a similarity, 6 more where the rig frame is free beside the common one; a motion that
    // nothing sees at all is no gauge either.
    const bool unseen = (information.reduced.diagonal().array() <= 0).any();
    if (free.scaled.cols() > 13 || unseen) CheckDetermined(information, free);
    gauge_ = free.scaled.transpose() * free.scale.asDiagonal();
    gauge_starts_ = information.motion_start;
    gauge_point_starts_ = information.point_start;
  }

  void AddGauge(ceres::Problem& ceres_problem) {
    std::vector<Eigen::MatrixXd> A;
    std::vector<Eigen::VectorXd> x0;
    std::vector<double*> blocks;
    const auto add = [&](int start, auto& value) {
      if (start < 0) return;
      A.emplace_back(gauge_.middleCols(start, value.size()));
      x0.emplace_back(value);
      blocks.push_back(value.data());
    };
    for (std::size_t k = 0; k < state_.motions.size(); ++k)
      add(gauge_starts_[k], state_.motions[k]);
    for (std::size_t k = 0; k < state_.points.size(); ++k) {
      add(gauge_point_starts_[k], state_.points[k]);
    }
    if (!blocks.empty()) ceres_problem.AddResidualBlock(new GaugeCost(A, x0), nullptr, blocks);
  }

  void Solve(BundleResult& out) {
    ceres::Problem::Options problem_options;
    problem_options.evaluation_callback = &state_;
    problem_options.loss_function_ownership = ceres::TAKE_OWNERSHIP;
    ceres::Problem ceres_problem(problem_options);
    for (const BundleObservation& o : problem_.observations) {
      ceres_problem.AddResidualBlock(new ObservationCost(state_, o), MakeLoss(options_),
                                     BlocksOf(o));
    }
    for (const KnownDistance& d : problem_.distances) {
      ceres_problem.AddResidualBlock(new DistanceCost(d), nullptr,
                                     state_.points[static_cast<std::size_t>(d.point_a)].data(),
                                     state_.points[static_cast<std::size_t>(d.point_b)].data());
    }
    if (gauge_.rows() > 0) AddGauge(ceres_problem);
    const auto hold = [&](double* block, bool fixed) {
      if (fixed && ceres_problem.HasParameterBlock(block))
        ceres_problem.SetParameterBlockConstant(block);
    };
    for (std::size_t k = 0; k < state_.intrinsics.size(); ++k) {
      hold(state_.intrinsics[k].data(), problem_.cameras[k].fixed);
    }
    for (std::size_t k = 0; k < state_.motions.size(); ++k) {
      hold(state_.motions[k].data(), problem_.motions[k].fixed);
    }
    for (std::size_t k = 0; k < state_.points.size(); ++k) {
      hold(state_.points[k].data(), problem_.points[k].fixed);
    }
    ceres::Solver::Options o;
    o.num_threads = 1;  // sums in one order: the same bits everywhere
    o.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    o.max_num_iterations = options_.max_iterations;
    o.function_tolerance = 1e-14;
    o.gradient_tolerance = 1e-14;
    o.parameter_tolerance = 1e-12;
    o.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(o, &ceres_problem, &summary);
    out.converged = summary.termination_type == ceres::CONVERGENCE;
    out.iterations = static_cast<int>(summary.iterations.size());
  }

  void CopyBack(BundleResult& out) {
    state_.Update();
    for (std::size_t k = 0; k < state_.cameras.size(); ++k) {
      if (!problem_.cameras[k].fixed) out.solved.cameras[k].camera = state_.cameras[k];
    }
    for (std::size_t k = 0; k < state_.motions.size(); ++k) {
      if (problem_.motions[k].fixed) continue;
      out.solved.motions[k].motion =
          Rigid3::FromRotationVector(state_.motions[k].head<3>(), state_.motions[k].tail<3>());
    }
    for (std::size_t k = 0; k < state_.points.size(); ++k) {
      if (!problem_.points[k].fixed) out.solved.points[k].point_mm = state_.points[k];
    }
  }

  const BundleProblem& problem_;
  const BundleOptions& options_;
  State state_;
  Eigen::MatrixXd gauge_;  // rows of the minimal prior on the core
  std::vector<int> gauge_starts_, gauge_point_starts_;
};

}  // namespace

void BundleOptions::Check() const {
  if (!(loss_scale_sigmas > 0)) {
    throw UsageError("bundle adjustment: loss_scale_sigmas must be positive");
  }
  if (max_iterations < 1) throw UsageError("bundle adjustment: max_iterations must be at least 1");
}

Eigen::MatrixXd BundleResult::Covariance(std::span<const BundleBlock> blocks, bool scaled) const {
  const Eigen::MatrixXd out = information->Joint({blocks.begin(), blocks.end()});
  return scaled ? Eigen::MatrixXd(out * (sigma0 * sigma0)) : out;
}

BundleResult AdjustBundle(const BundleProblem& problem, const BundleOptions& options) {
  options.Check();
  CheckProblem(problem);
  return Adjustment(problem, options).Run();
}

}  // namespace plumbline
