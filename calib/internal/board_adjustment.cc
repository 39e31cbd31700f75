#include "calib/internal/board_adjustment.h"

#include <ceres/ceres.h>
#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "calib/error.h"
#include "calib/internal/mrcal.h"
#include "calib/median.h"

namespace plumbline::internal {
namespace {

using RowMajor23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using RowMajor26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;

// target_from_source * p with derivatives with respect to (rotation vector, translation) and to p.
struct MovedPoint {
  Eigen::Vector3d point;
  Eigen::Matrix<double, 3, 6> d_motion;
  Eigen::Matrix3d d_point;
};

MovedPoint Move(const double* motion, const Eigen::Vector3d& p) {
  const Eigen::Map<const Eigen::Vector3d> r(motion), t(motion + 3);
  Eigen::Matrix3d dR[3];
  MovedPoint out;
  out.d_point = RotationFromVector(r, dR);
  out.point = out.d_point * p + t;
  for (int k = 0; k < 3; ++k) out.d_motion.col(k) = dR[k] * p;
  out.d_motion.rightCols<3>().setIdentity();
  return out;
}

// The projection of one target point with all derivatives wanted (null: not wanted). Returns false
// where it has no image.
struct ProjectionBlocks {
  double* intrinsics = nullptr;       // 2 x N
  double* right_from_left = nullptr;  // 2 x 6
  double* left_from_board = nullptr;  // 2 x 6
  double* target = nullptr;           // 2 x 3
};

bool ProjectTarget(const mrcal_lensmodel_t& lens, int intrinsics_count, const double* intrinsics,
                   const double* right_from_left, const double* left_from_board,
                   const double* target, Eigen::Vector2d* pixel, const ProjectionBlocks& out) {
  const MovedPoint in_left = Move(left_from_board, Eigen::Map<const Eigen::Vector3d>(target));
  MovedPoint in_camera;
  if (right_from_left != nullptr) {
    in_camera = Move(right_from_left, in_left.point);
  } else {
    in_camera.point = in_left.point;
    in_camera.d_point.setIdentity();
  }
  if (!(in_camera.point.z() > 0) && lens.type != MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC)
    return false;
  const mrcal_point3_t p = {{in_camera.point.x(), in_camera.point.y(), in_camera.point.z()}};
  mrcal_point2_t q;
  std::array<mrcal_point3_t, 2> dq_dp;
  if (out.intrinsics != nullptr) std::fill_n(out.intrinsics, 2 * intrinsics_count, 0.0);
  mrcal_project(&q, dq_dp.data(), out.intrinsics, &p, 1, &lens, intrinsics);
  *pixel << q.x, q.y;
  if (!pixel->allFinite()) return false;
  RowMajor23 d_point;
  d_point << dq_dp[0].x, dq_dp[0].y, dq_dp[0].z, dq_dp[1].x, dq_dp[1].y, dq_dp[1].z;
  if (out.right_from_left != nullptr) {
    Eigen::Map<RowMajor26> d(out.right_from_left);
    if (right_from_left != nullptr) {
      d = d_point * in_camera.d_motion;
    } else {
      d.setZero();
    }
  }
  const RowMajor23 d_left = d_point * in_camera.d_point;
  if (out.left_from_board != nullptr)
    Eigen::Map<RowMajor26>(out.left_from_board) = d_left * in_left.d_motion;
  if (out.target != nullptr) Eigen::Map<RowMajor23>(out.target) = d_left * in_left.d_point;
  return true;
}

// (predicted - observed) / sigma. Parameter blocks: intrinsics, left_from_board, target, and
// right_from_left for the right camera.
class BoardCost : public ceres::CostFunction {
 public:
  BoardCost(const mrcal_lensmodel_t& lens, int intrinsics_count, bool is_right,
            const Eigen::Vector2d& pixel, double sigma_px)
      : lens_(lens),
        intrinsics_count_(intrinsics_count),
        is_right_(is_right),
        pixel_(pixel),
        weight_(1 / sigma_px) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = {intrinsics_count, 6, 3};
    if (is_right) mutable_parameter_block_sizes()->push_back(6);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    ProjectionBlocks blocks;
    if (jacobians != nullptr) {
      blocks.intrinsics = jacobians[0];
      blocks.left_from_board = jacobians[1];
      blocks.target = jacobians[2];
      if (is_right_) blocks.right_from_left = jacobians[3];
    }
    Eigen::Vector2d predicted;
    if (!ProjectTarget(lens_, intrinsics_count_, parameters[0], is_right_ ? parameters[3] : nullptr,
                       parameters[1], parameters[2], &predicted, blocks)) {
      return false;
    }
    Eigen::Map<Eigen::Vector2d>(residuals, 2) = weight_ * (predicted - pixel_);
    const auto scale = [this](double* block, int columns) {
      if (block != nullptr) Eigen::Map<Eigen::VectorXd>(block, 2 * columns) *= weight_;
    };
    scale(blocks.intrinsics, intrinsics_count_);
    scale(blocks.left_from_board, 6);
    scale(blocks.target, 3);
    scale(blocks.right_from_left, 6);
    return true;
  }

 private:
  mrcal_lensmodel_t lens_;
  int intrinsics_count_;
  bool is_right_;
  Eigen::Vector2d pixel_;
  double weight_;
};

// (point - nominal) / sigma: what is known of a printed board before any photograph.
class TargetPrior : public ceres::SizedCostFunction<3, 3> {
 public:
  TargetPrior(const Eigen::Vector3d& nominal_mm, double sigma_mm)
      : nominal_(nominal_mm), weight_(1 / sigma_mm) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    Eigen::Map<Eigen::Vector3d>(residuals, 3) =
        weight_ * (Eigen::Map<const Eigen::Vector3d>(parameters[0]) - nominal_);
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix3d>(jacobians[0], 3, 3) = weight_ * Eigen::Matrix3d::Identity();
    }
    return true;
  }

 private:
  Eigen::Vector3d nominal_;
  double weight_;
};

// (control point - anchor) / sigma of a splined lens; the core has no residuals.
class SplinePrior : public ceres::CostFunction {
 public:
  explicit SplinePrior(const Eigen::VectorXd& anchor) : anchor_(anchor) {
    *mutable_parameter_block_sizes() = {static_cast<int>(anchor.size())};
    set_num_residuals(static_cast<int>(anchor.size()) - kSplineCore);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Index n = num_residuals();
    const Eigen::Map<const Eigen::VectorXd> intrinsics(parameters[0], anchor_.size());
    Eigen::Map<Eigen::VectorXd>(residuals, n) = (intrinsics - anchor_).tail(n) / kSplineSigma;
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> J(
          jacobians[0], n, anchor_.size());
      J.setZero();
      J.rightCols(n).diagonal().setConstant(1 / kSplineSigma);
    }
    return true;
  }

 private:
  Eigen::VectorXd anchor_;
};

using Motion = std::array<double, 6>;

Motion ToMotion(const Rigid3& rigid) {
  const Eigen::Vector3d r = rigid.RotationVector();
  return {r.x(),
          r.y(),
          r.z(),
          rigid.translation_mm.x(),
          rigid.translation_mm.y(),
          rigid.translation_mm.z()};
}

Rigid3 FromMotion(const double* m) {
  return Rigid3::FromRotationVector({m[0], m[1], m[2]}, {m[3], m[4], m[5]});
}

const Camera& CameraOf(const BoardProblem& problem, int camera) {
  return camera == 0 ? problem.rig.left : problem.rig.right;
}

// The parameter blocks of a problem in the form that Ceres wants them. All in one array: Ceres
// orders blocks by their addresses, and this way the order, and with it every rounding, is the same
// each time.
class Blocks {
 public:
  explicit Blocks(const BoardProblem& p)
      : right_(static_cast<std::size_t>(p.rig.left.parameter_count())),
        motion_(right_ + static_cast<std::size_t>(p.rig.right.parameter_count())),
        poses_(motion_ + 6),
        target_(poses_ + 6 * p.left_from_board.size()),
        values_(target_ + 3 * p.target_mm.size()) {
    Store(p.rig.left.parameters(), Intrinsics(0));
    Store(p.rig.right.parameters(), Intrinsics(1));
    Store(ToMotion(p.rig.right_from_left), RightFromLeft());
    for (std::size_t i = 0; i < p.left_from_board.size(); ++i)
      Store(ToMotion(p.left_from_board[i]), LeftFromBoard(i));
    for (std::size_t i = 0; i < p.target_mm.size(); ++i) Store(p.target_mm[i], Target(i));
  }

  double* Intrinsics(int camera) { return values_.data() + (camera == 0 ? 0 : right_); }
  double* RightFromLeft() { return values_.data() + motion_; }
  double* LeftFromBoard(std::size_t pair) { return values_.data() + poses_ + 6 * pair; }
  double* Target(std::size_t id) { return values_.data() + target_ + 3 * id; }

  void StoreIn(BoardProblem& p) {
    p.rig.left = p.rig.left.WithParameters(
        Eigen::Map<Eigen::VectorXd>(Intrinsics(0), p.rig.left.parameter_count()));
    p.rig.right = p.rig.right.WithParameters(
        Eigen::Map<Eigen::VectorXd>(Intrinsics(1), p.rig.right.parameter_count()));
    p.rig.right_from_left = FromMotion(RightFromLeft());
    for (std::size_t i = 0; i < p.left_from_board.size(); ++i)
      p.left_from_board[i] = FromMotion(LeftFromBoard(i));
    for (std::size_t i = 0; i < p.target_mm.size(); ++i)
      p.target_mm[i] = Eigen::Map<Eigen::Vector3d>(Target(i));
  }

 private:
  template <typename Values>
  static void Store(const Values& values, double* to) {
    std::copy(values.begin(), values.end(), to);
  }

  std::size_t right_, motion_, poses_,
      target_;  // first index of each; the left intrinsics begin at 0
  std::vector<double> values_;
};

void HoldConstant(ceres::Problem& ceres_problem, double* block) {
  if (ceres_problem.HasParameterBlock(block)) ceres_problem.SetParameterBlockConstant(block);
}

}  // namespace

double BoardProblem::Sigma(const BoardObservation& o) const {
  return std::hypot(o.sigma_px, floor_px);
}

ObservationJacobians Linearise(const BoardProblem& problem, const BoardObservation& o) {
  const Camera& camera = CameraOf(problem, o.camera);
  const mrcal_lensmodel_t lens = ToMrcal(camera.model());
  const int n = camera.parameter_count();
  const Motion extrinsics = ToMotion(problem.rig.right_from_left);
  const Motion pose = ToMotion(problem.left_from_board[static_cast<std::size_t>(o.pair)]);
  ObservationJacobians out;
  out.intrinsics.resize(2, n);
  Eigen::Vector2d predicted = Eigen::Vector2d::Constant(std::nan(""));
  ProjectTarget(lens, n, camera.parameters().data(), o.camera == 1 ? extrinsics.data() : nullptr,
                pose.data(), problem.target_mm[static_cast<std::size_t>(o.id)].data(), &predicted,
                {out.intrinsics.data(), out.right_from_left.data(), out.left_from_board.data(),
                 out.target.data()});
  out.residual_px = o.pixel - o.disc_offset_px - predicted;
  out.intrinsics *= -1;
  out.right_from_left *= -1;
  out.left_from_board *= -1;
  out.target *= -1;
  return out;
}

void Adjust(BoardProblem& problem, const AdjustmentOptions& options) {
  Blocks blocks(problem);
  ceres::Problem ceres_problem;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  std::vector<bool> target_seen(problem.target_mm.size(), false);
  for (const BoardObservation& o : problem.observations) {
    if (o.outlier) continue;
    const Camera& camera = CameraOf(problem, o.camera);
    const auto pair = static_cast<std::size_t>(o.pair);
    const auto id = static_cast<std::size_t>(o.id);
    std::vector<double*> parameters = {blocks.Intrinsics(o.camera), blocks.LeftFromBoard(pair),
                                       blocks.Target(id)};
    if (o.camera == 1) parameters.push_back(blocks.RightFromLeft());
    ceres_problem.AddResidualBlock(
        new BoardCost(ToMrcal(camera.model()), camera.parameter_count(), o.camera == 1,
                      o.pixel - o.disc_offset_px, problem.Sigma(o)),
        options.robust ? new ceres::CauchyLoss(3) : nullptr, parameters);
    ordering->AddElementToGroup(blocks.LeftFromBoard(pair), 0);
    target_seen[id] = true;
  }
  for (std::size_t id = 0; id < problem.target_mm.size(); ++id) {
    if (!target_seen[id]) continue;
    if (options.fix_target) {
      ceres_problem.SetParameterBlockConstant(blocks.Target(id));
    } else {
      ceres_problem.AddResidualBlock(
          new TargetPrior(problem.nominal_mm[id], options.target_sigma_mm), nullptr,
          blocks.Target(id));
    }
    ordering->AddElementToGroup(blocks.Target(id), 1);
  }
  for (double* block : {blocks.Intrinsics(0), blocks.Intrinsics(1), blocks.RightFromLeft()}) {
    if (!ceres_problem.HasParameterBlock(block)) continue;
    ordering->AddElementToGroup(block, 1);
    if (options.fix_cameras) HoldConstant(ceres_problem, block);
  }
  for (int camera : {0, 1}) {
    const Eigen::VectorXd& anchor = problem.spline_anchor[static_cast<std::size_t>(camera)];
    if (anchor.size() == 0 || options.fix_cameras) continue;
    ceres_problem.AddResidualBlock(new SplinePrior(anchor), nullptr, blocks.Intrinsics(camera));
    ceres_problem.SetManifold(
        blocks.Intrinsics(camera),
        new ceres::SubsetManifold(static_cast<int>(anchor.size()), {0, 1, 2, 3}));
  }
  ceres::Solver::Options solver;
  // Eigen's own factorisations: unlike a threaded BLAS they give the same bits every time.
  solver.linear_solver_type = options.fix_cameras && options.fix_target
                                  ? ceres::SPARSE_NORMAL_CHOLESKY
                                  : ceres::DENSE_SCHUR;
  solver.dense_linear_algebra_library_type = ceres::EIGEN;
  solver.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  if (solver.linear_solver_type == ceres::DENSE_SCHUR) solver.linear_solver_ordering = ordering;
  solver.num_threads = 1;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = 1e-11;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-12;
  solver.logging_type = ceres::SILENT;
  FLAGS_minloglevel = google::GLOG_ERROR;  // a step that fails is tried again with more damping:
                                           // nothing to tell anybody
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &ceres_problem, &summary);
  if (!summary.IsSolutionUsable()) {
    throw InputError("the joint adjustment of cameras and board found no solution (" +
                     summary.message +
                     "); check the board word and add photographs with more tilt");
  }
  if (std::min(blocks.Intrinsics(0)[0], blocks.Intrinsics(0)[1]) <= 0 ||
      std::min(blocks.Intrinsics(1)[0], blocks.Intrinsics(1)[1]) <= 0) {
    throw InputError(
        "the joint adjustment of cameras and board gave a focal length below zero; check the board "
        "word and add photographs with more tilt");
  }
  blocks.StoreIn(problem);
}

void PredictDiscOffsets(BoardProblem& problem) {
  if (problem.disc_radius_mm <= 0) return;
  constexpr int kRim = 32;
  for (BoardObservation& o : problem.observations) {
    const Rigid3& pose = problem.left_from_board[static_cast<std::size_t>(o.pair)];
    const Rigid3 camera_from_board = o.camera == 0 ? pose : problem.rig.right_from_left * pose;
    const Camera& camera = CameraOf(problem, o.camera);
    const Eigen::Vector3d& centre = problem.target_mm[static_cast<std::size_t>(o.id)];
    const Eigen::Vector2d image_of_centre = camera.Project(camera_from_board * centre);
    std::array<Eigen::Vector2d, kRim> rim;
    for (int k = 0; k < kRim; ++k) {
      const double angle = 2 * M_PI * k / kRim;
      const Eigen::Vector3d on_rim =
          centre + problem.disc_radius_mm * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0);
      rim[static_cast<std::size_t>(k)] =
          camera.Project(camera_from_board * on_rim) - image_of_centre;
    }
    // Centroid of the polygon (Green's theorem), relative to the image of the centre.
    double area2 = 0;
    Eigen::Vector2d moment = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < kRim; ++k) {
      const Eigen::Vector2d& a = rim[k];
      const Eigen::Vector2d& b = rim[(k + 1) % kRim];
      const double cross = a.x() * b.y() - a.y() * b.x();
      area2 += cross;
      moment += cross * (a + b);
    }
    const Eigen::Vector2d offset = moment / (3 * area2);
    o.disc_offset_px = offset.allFinite() ? offset : Eigen::Vector2d(0, 0);
  }
}

namespace {

Eigen::Vector2d Residual(const BoardProblem& problem, const BoardObservation& o) {
  const Eigen::Vector3d in_left = problem.left_from_board[static_cast<std::size_t>(o.pair)] *
                                  problem.target_mm[static_cast<std::size_t>(o.id)];
  const Eigen::Vector3d in_camera = o.camera == 0 ? in_left : problem.rig.right_from_left * in_left;
  return o.pixel - o.disc_offset_px - CameraOf(problem, o.camera).Project(in_camera);
}

}  // namespace

std::vector<Eigen::Vector2d> Residuals(const BoardProblem& problem) {
  std::vector<Eigen::Vector2d> out;
  out.reserve(problem.observations.size());
  for (const BoardObservation& o : problem.observations) out.push_back(Residual(problem, o));
  return out;
}

int MarkOutliers(BoardProblem& problem, double sigmas) {
  const std::vector<Eigen::Vector2d> residuals = Residuals(problem);
  std::vector<double> normalised;
  normalised.reserve(residuals.size());
  for (std::size_t i = 0; i < residuals.size(); ++i)
    normalised.push_back(residuals[i].norm() / problem.Sigma(problem.observations[i]));
  // The median length of a standard normal 2-vector is sqrt(2 ln 2).
  std::vector<double> sorted;
  for (double n : normalised) {
    if (std::isfinite(n)) sorted.push_back(n);
  }
  if (sorted.empty()) return 0;
  const double limit =
      sigmas * std::max(Median(std::move(sorted)) / std::sqrt(2 * std::log(2.0)), 1e-12);
  int changed = 0;
  for (std::size_t i = 0; i < normalised.size(); ++i) {
    const bool outlier = !(normalised[i] <= limit);
    changed += outlier != problem.observations[i].outlier ? 1 : 0;
    problem.observations[i].outlier = outlier;
  }
  return changed;
}

double DegreesOfFreedom(const BoardProblem& problem, bool target_free) {
  double scalars = 0;
  std::vector<bool> pair_seen(problem.left_from_board.size(), false),
      id_seen(problem.target_mm.size(), false);
  for (const BoardObservation& o : problem.observations) {
    if (o.outlier) continue;
    scalars += 2;
    pair_seen[static_cast<std::size_t>(o.pair)] = true;
    id_seen[static_cast<std::size_t>(o.id)] = true;
  }
  double free = problem.rig.ParameterCount() +
                6.0 * static_cast<double>(std::count(pair_seen.begin(), pair_seen.end(), true));
  // Seven directions of the target, its similarity transforms, are held by convention.
  if (target_free)
    free += 3.0 * static_cast<double>(std::count(id_seen.begin(), id_seen.end(), true)) - 7;
  return scalars - free;
}

void EstimateFloor(BoardProblem& problem, bool target_free) {
  const std::vector<Eigen::Vector2d> residuals = Residuals(problem);
  const double dof = DegreesOfFreedom(problem, target_free);
  if (dof <= 0) return;
  const auto excess = [&](double floor_px) {
    double chi2 = 0;
    for (std::size_t i = 0; i < residuals.size(); ++i) {
      const BoardObservation& o = problem.observations[i];
      if (!o.outlier)
        chi2 += residuals[i].squaredNorm() / (o.sigma_px * o.sigma_px + floor_px * floor_px);
    }
    return chi2 / dof - 1;
  };
  problem.floor_px = 0;
  if (excess(0) <= 0) return;
  double low = 0, high = 1;
  while (excess(high) > 0) high *= 2;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (excess(middle) > 0 ? low : high) = middle;
  }
  problem.floor_px = high;
}

double ResidualRms(const BoardProblem& problem, int camera, int pair) {
  double sum = 0;
  double count = 0;
  for (const BoardObservation& o : problem.observations) {
    if (o.outlier || (camera >= 0 && o.camera != camera) || (pair >= 0 && o.pair != pair)) continue;
    sum += Residual(problem, o).squaredNorm();
    count += 2;
  }
  return count > 0 ? std::sqrt(sum / count) : 0;
}

}  // namespace plumbline::internal
