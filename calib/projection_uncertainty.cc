#include "calib/projection_uncertainty.h"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <cmath>
#include <vector>

#include "calib/error.h"
#include "calib/internal/mrcal_solver.h"
#include "calib/stereo_rig.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

constexpr double kMillimetresPerMetre = 1000;

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A pose in metres, with what its derivatives need.
struct Pose {
  explicit Pose(const Eigen::Matrix<double, 6, 1>& rt) : t(rt.tail<3>()) {
    R = RotationFromVector(rt.head<3>(), dR);
  }
  Eigen::Matrix3d R;
  Eigen::Matrix3d dR[3];
  Eigen::Vector3d t;

  // The turn of the frame per change of the rotation vector: dR = [L dr]x R.
  Eigen::Matrix3d L() const {
    Eigen::Matrix3d l;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Matrix3d s = dR[k] * R.transpose();
      l.col(k) << s(2, 1), s(0, 2), s(1, 0);
    }
    return l;
  }
  // d (R p + t) / d (r, t)
  Eigen::Matrix<double, 3, 6> PointJacobian(const Eigen::Vector3d& p) const {
    Eigen::Matrix<double, 3, 6> J;
    J << dR[0] * p, dR[1] * p, dR[2] * p, Eigen::Matrix3d::Identity();
    return J;
  }
  // d rt(delta * this) / d delta at delta = identity.
  Matrix6 LeftComposeJacobian() const {
    Matrix6 J = Matrix6::Zero();
    J.topLeftCorner<3, 3>() = L().inverse();
    J.bottomLeftCorner<3, 3>() = -Skew(t);
    J.bottomRightCorner<3, 3>().setIdentity();
    return J;
  }
};

// The motion of camera coordinates that a motion of reference coordinates amounts to:
// delta_c = T_cr delta_r T_cr^-1, first order, (rotation, translation).
Matrix6 Adjoint(const Pose& camera_from_ref) {
  Matrix6 A = Matrix6::Zero();
  A.topLeftCorner<3, 3>() = camera_from_ref.R;
  A.bottomRightCorner<3, 3>() = camera_from_ref.R;
  A.bottomLeftCorner<3, 3>() = Skew(camera_from_ref.t) * camera_from_ref.R;
  return A;
}

// [skew(p) | -I]: how a point fixed in the old camera frame moves in the new one.
Eigen::Matrix<double, 3, 6> FixedPointMotion(const Eigen::Vector3d& p, bool at_infinity) {
  Eigen::Matrix<double, 3, 6> M;
  M << Skew(p), -Eigen::Matrix3d::Identity();
  if (at_infinity) M.rightCols<3>().setZero();
  return M;
}

}  // namespace

struct ProjectionUncertainty::Impl {
  OptimizationInputs inputs;
  internal::OptimizerState state;
  Eigen::SparseMatrix<double> information;  // J'J
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor;
  Eigen::SparseMatrix<double> information_obs;  // J_obs'J_obs; empty without regularization
  double noise_px = 0;
  std::vector<Eigen::MatrixXd> K;  // (6, states), packed columns, one a camera; empty: not defined

  const internal::StateLayout& layout() const { return state.layout; }
  int states() const { return layout().state_count; }
  int observation_rows() const { return layout().board_measurements + layout().point_measurements; }

  void RequireCamera(int camera) const {
    if (camera < 0 || camera >= inputs.camera_count()) {
      throw InputError("projection uncertainty: the calibration has no such camera");
    }
  }
  Pose ExtrinsicPose(int extrinsics) const {
    return Pose(extrinsics < 0 ? Eigen::Matrix<double, 6, 1>::Zero().eval()
                               : inputs.extrinsics_rt_fromref.row(extrinsics).transpose().eval());
  }

  // Var(F) from dF/db_packed (n, states).
  Eigen::MatrixXd Covariance(const Eigen::MatrixXd& dF_packed) const {
    const Eigen::MatrixXd A = factor.solve(dF_packed.transpose());
    const Eigen::MatrixXd V = information_obs.size() > 0
                                  ? Eigen::MatrixXd(A.transpose() * (information_obs * A))
                                  : Eigen::MatrixXd(dF_packed * A);
    return noise_px * noise_px * 0.5 * (V + V.transpose());
  }

  // Adds d F / d intrinsics (F, parameters of one camera), unpacked, to dF/db_packed.
  void AddIntrinsics(const Eigen::MatrixXd& dF, int camera, Eigen::MatrixXd& dF_packed) const {
    const int n = layout().intrinsics_per_camera;
    if (n == 0) return;
    const int at = layout().intrinsics + camera * n;
    dF_packed.middleCols(at, n) +=
        dF.middleCols(layout().first_intrinsic, n) * state.unpack_scale.segment(at, n).asDiagonal();
  }
  void AddBlock(const Eigen::MatrixXd& dF, int at, Eigen::MatrixXd& dF_packed) const {
    dF_packed.middleCols(at, dF.cols()) +=
        dF * state.unpack_scale.segment(at, dF.cols()).asDiagonal();
  }

  // The rows of one camera: calls f(row, index of the board or point pose, is_board, extrinsics).
  template <typename F>
  void ForEachRowOf(int camera, const F& f) const {
    const auto& boards = inputs.indices_frame_camintrinsics_camextrinsics;
    const int per_board = 2 * inputs.board_rows * inputs.board_columns;
    for (int o = 0; o < inputs.board_observation_count(); ++o) {
      if (boards(o, 1) != camera) continue;
      for (int k = 0; k < per_board; ++k) f(o * per_board + k, boards(o, 0), true);
    }
    const auto& points = inputs.indices_point_camintrinsics_camextrinsics;
    const int per_point =
        points.rows() == 0 ? 0 : layout().point_measurements / static_cast<int>(points.rows());
    for (int o = 0; o < inputs.point_observation_count(); ++o) {
      if (points(o, 1) != camera) continue;
      for (int k = 0; k < per_point; ++k) {
        f(layout().board_measurements + o * per_point + k, points(o, 0), false);
      }
    }
  }

  // d (unknowns of a board pose, point or camera pose, unpacked) / d delta, one matrix each.
  struct MotionJacobians {
    int camera_at = -1;  // state index of the camera's own pose; -1: the others are used
    Matrix6 camera;
    std::vector<Matrix6> frames;
  };
  MotionJacobians Motion(int camera) const {
    MotionJacobians out;
    const int e = inputs.ExtrinsicsOfCamera(camera);
    const Pose camera_from_ref = ExtrinsicPose(e);
    if (e >= 0 && layout().extrinsics >= 0) {
      out.camera_at = layout().extrinsics + 6 * e;
      out.camera = camera_from_ref.LeftComposeJacobian();
      return out;
    }
    // The world moved instead, by the same motion seen from the reference.
    const Matrix6 ref_from_camera = Adjoint(camera_from_ref).inverse();
    for (int i = 0; i < inputs.frame_count(); ++i) {
      const Pose ref_from_board(inputs.frames_rt_toref.row(i).transpose().eval());
      out.frames.push_back(ref_from_board.LeftComposeJacobian() * ref_from_camera);
    }
    return out;
  }

  // Row `row` of Jx = d x / d delta.
  Eigen::Matrix<double, 1, 6> MotionRow(int row, int index, bool is_board,
                                        const MotionJacobians& motion,
                                        const Matrix6& ref_from_camera) const {
    Eigen::Matrix<double, 1, 6> jx = Eigen::Matrix<double, 1, 6>::Zero();
    const int point_at = layout().points + 3 * index;
    const int frame_at = layout().frames + 6 * index;
    const bool free_point =
        !is_board && layout().points >= 0 && index < inputs.points.rows() - inputs.fixed_points;
    for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(state.J, row); it; ++it) {
      const int column = static_cast<int>(it.col());
      const double dx_db = it.value() / state.unpack_scale[column];
      if (motion.camera_at >= 0) {
        const int k = column - motion.camera_at;
        if (k >= 0 && k < 6) jx += dx_db * motion.camera.row(k);
      } else if (is_board && column >= frame_at && column < frame_at + 6) {
        jx += dx_db * motion.frames[static_cast<std::size_t>(index)].row(column - frame_at);
      } else if (free_point && column >= point_at && column < point_at + 3) {
        Eigen::Matrix<double, 3, 6> moved;
        moved << -Skew(inputs.points.row(index).transpose()), Eigen::Matrix3d::Identity();
        jx += dx_db * (moved * ref_from_camera).row(column - point_at);
      }
    }
    return jx;
  }

  // K = -(Jx'Jx)^-1 Jx' J_{all but intrinsics}; empty where the solve holds no geometry free.
  Eigen::MatrixXd CrossReprojectionGain(int camera) const {
    const int e = inputs.ExtrinsicsOfCamera(camera);
    if ((e < 0 || layout().extrinsics < 0) && layout().frames < 0) return {};
    const MotionJacobians motion = Motion(camera);
    const Matrix6 ref_from_camera = Adjoint(ExtrinsicPose(e)).inverse();
    const int intrinsics_end =
        layout().intrinsics < 0
            ? 0
            : layout().intrinsics + inputs.camera_count() * layout().intrinsics_per_camera;
    Matrix6 N = Matrix6::Zero();
    Eigen::MatrixXd g = Eigen::MatrixXd::Zero(6, states());
    ForEachRowOf(camera, [&](int row, int index, bool is_board) {
      const Eigen::Matrix<double, 1, 6> jx =
          MotionRow(row, index, is_board, motion, ref_from_camera);
      N += jx.transpose() * jx;
      for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(state.J, row); it; ++it) {
        if (it.col() >= intrinsics_end) g.col(it.col()) += jx.transpose() * it.value();
      }
    });
    const Eigen::LDLT<Matrix6> ldlt(N);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 0)) return {};
    return -ldlt.solve(g);
  }

  const Eigen::MatrixXd& Gain(int camera) const {
    const Eigen::MatrixXd& gain = K[static_cast<std::size_t>(camera)];
    if (gain.size() == 0) {
      throw InputError(
          "projection uncertainty: this calibration held both the boards and the camera's pose "
          "fixed, "
          "so that there is nothing to reproject across");
    }
    return gain;
  }

  // Derivatives of the projection of a point in metres.
  Camera::Projection Project(int camera, const Eigen::Vector3d& point_mm) const {
    RequireCamera(camera);
    Camera::Projection at = inputs.CameraAt(camera).ProjectWithJacobians(point_mm);
    if (!at.pixel.allFinite()) {
      throw InputError("projection uncertainty: the camera cannot see this point");
    }
    at.d_pixel_d_point *= kMillimetresPerMetre;
    return at;
  }

  Eigen::MatrixXd TriangulationJacobian(int left, int right, const Eigen::Vector3d& point_mm) const;
};

ProjectionUncertainty::ProjectionUncertainty(const OptimizationInputs& inputs,
                                             const Options& options) {
  auto impl = std::make_shared<Impl>();
  impl->inputs = inputs;
  impl->state = internal::OptimizerCallback(inputs);
  const auto& state = impl->state;
  const int rows = impl->observation_rows();
  const Eigen::SparseMatrix<double> J = state.J;
  impl->information = J.transpose() * J;
  impl->factor.compute(impl->information);
  if (impl->factor.info() != Eigen::Success || !(impl->factor.vectorD().minCoeff() > 0)) {
    throw InputError(
        "projection uncertainty: the observations do not determine the calibration's unknowns; add "
        "photographs with the board tilted, or solve for less");
  }
  if (state.layout.regularization_measurements > 0) {
    const Eigen::SparseMatrix<double> observed = state.J.topRows(rows);
    impl->information_obs = observed.transpose() * observed;
  }
  if (options.noise_px) {
    impl->noise_px = *options.noise_px;
  } else {
    const auto inliers = [](const OptimizationInputs::RowMatrix3& o) {
      return static_cast<double>((o.col(2).array() > 0).count());
    };
    const double known =
        2 * (inliers(inputs.observations_board) + inliers(inputs.observations_point));
    const double freedom = 1 - state.layout.state_count / known;
    if (!(freedom > 0)) throw InputError("projection uncertainty: more unknowns than observations");
    impl->noise_px = std::sqrt(state.x.head(rows).squaredNorm() / known / freedom);
  }
  for (int c = 0; c < inputs.camera_count(); ++c) impl->K.push_back(impl->CrossReprojectionGain(c));
  impl_ = std::move(impl);
}

double ProjectionUncertainty::noise_px() const { return impl_->noise_px; }

Eigen::Matrix2d ProjectionUncertainty::MeanPcam(int camera,
                                                const Eigen::Vector3d& point_in_camera_mm,
                                                bool at_infinity) const {
  const auto& s = impl_->layout();
  const Camera::Projection at = impl_->Project(camera, point_in_camera_mm);
  const Eigen::Matrix<double, 2, 3>& dq_dp = at.d_pixel_d_point;
  Eigen::MatrixXd dq = Eigen::MatrixXd::Zero(2, impl_->states());
  impl_->AddIntrinsics(at.d_pixel_d_parameters, camera, dq);

  const int e = impl_->inputs.ExtrinsicsOfCamera(camera);
  const Pose camera_from_ref = impl_->ExtrinsicPose(e);
  const Eigen::Vector3d p = point_in_camera_mm / kMillimetresPerMetre;
  // A point at infinity is a direction: it turns, but does not move.
  const Eigen::Vector3d p_ref =
      camera_from_ref.R.transpose() * (at_infinity ? p : p - camera_from_ref.t);
  const auto jacobian = [&](const Pose& pose, const Eigen::Vector3d& point) {
    Eigen::Matrix<double, 3, 6> J = pose.PointJacobian(point);
    if (at_infinity) J.rightCols<3>().setZero();
    return J;
  };
  if (e >= 0 && s.extrinsics >= 0) {
    impl_->AddBlock(dq_dp * jacobian(camera_from_ref, p_ref), s.extrinsics + 6 * e, dq);
  }
  if (s.frames >= 0) {
    const int frames = impl_->inputs.frame_count();
    for (int i = 0; i < frames; ++i) {
      const Pose ref_from_board(impl_->inputs.frames_rt_toref.row(i).transpose().eval());
      const Eigen::Vector3d p_board =
          ref_from_board.R.transpose() * (at_infinity ? p_ref : p_ref - ref_from_board.t);
      impl_->AddBlock(dq_dp * camera_from_ref.R * jacobian(ref_from_board, p_board) / frames,
                      s.frames + 6 * i, dq);
    }
  }
  return impl_->Covariance(dq);
}

Eigen::Matrix2d ProjectionUncertainty::CrossReprojection(int camera,
                                                         const Eigen::Vector3d& point_in_camera_mm,
                                                         bool at_infinity) const {
  const Camera::Projection at = impl_->Project(camera, point_in_camera_mm);
  const Eigen::Vector3d p = point_in_camera_mm / kMillimetresPerMetre;
  Eigen::MatrixXd dq = at.d_pixel_d_point * FixedPointMotion(p, at_infinity) * impl_->Gain(camera);
  impl_->AddIntrinsics(at.d_pixel_d_parameters, camera, dq);
  return impl_->Covariance(dq);
}

// d point / d b_packed (3, states; metres) of the point triangulated in the left camera.
Eigen::MatrixXd ProjectionUncertainty::Impl::TriangulationJacobian(
    int left, int right, const Eigen::Vector3d& point_mm) const {
  RequireCamera(left);
  RequireCamera(right);
  const int e0 = inputs.ExtrinsicsOfCamera(left), e1 = inputs.ExtrinsicsOfCamera(right);
  const Pose pose0 = ExtrinsicPose(e0), pose1 = ExtrinsicPose(e1);
  const Eigen::Matrix3d R = pose1.R * pose0.R.transpose();
  const Eigen::Vector3d t = pose1.t - R * pose0.t;
  const StereoRig rig{
      inputs.CameraAt(left), inputs.CameraAt(right), {R, t * kMillimetresPerMetre}, {}, ""};
  const Eigen::Vector2d q0 = rig.left.Project(point_mm);
  const Eigen::Vector2d q1 = rig.right.Project(rig.right_from_left * point_mm);
  const Eigen::MatrixXd dp = TriangulationParameterJacobian(rig, q0, q1);
  if (!dp.allFinite()) {
    throw InputError("projection uncertainty: the two cameras cannot both see this point");
  }
  const int n = rig.left.parameter_count();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(3, states());
  AddIntrinsics(dp.leftCols(n) / kMillimetresPerMetre, left, out);
  AddIntrinsics(dp.middleCols(n, n) / kMillimetresPerMetre, right, out);
  // The pose of the right camera: its rotation vector in rad, its translation from mm to metres.
  const Eigen::Matrix3d dp_dr = dp.middleCols<3>(2 * n) / kMillimetresPerMetre;
  const Eigen::Matrix3d dp_dt = dp.rightCols<3>();
  Eigen::Matrix<double, 6, 1> rt;
  rt << rig.right_from_left.RotationVector(), t;
  // A turn w of the right frame (R -> exp([w]x) R) changes the rotation vector by L^-1 w.
  const Eigen::Matrix3d dp_dw = dp_dr * Pose(rt).L().inverse();
  if (layout().extrinsics < 0) return out;
  if (e1 >= 0) {  // R1 -> exp([L1 dr1]x) R1, so t changes by [L1 dr1]x (t - t1)
    Eigen::Matrix<double, 3, 6> J;
    J << (dp_dw - dp_dt * Skew(t - pose1.t)) * pose1.L(), dp_dt;
    AddBlock(J, layout().extrinsics + 6 * e1, out);
  }
  if (e0 >= 0) {  // R0 -> exp([L0 dr0]x) R0, so R -> R exp(-[L0 dr0]x)
    Eigen::Matrix<double, 3, 6> J;
    J << (-dp_dw * R - dp_dt * R * Skew(pose0.t)) * pose0.L(), -dp_dt * R;
    AddBlock(J, layout().extrinsics + 6 * e0, out);
  }
  return out;
}

Eigen::Matrix3d ProjectionUncertainty::TriangulatedPoint(
    int left, int right, const Eigen::Vector3d& point_in_left_mm) const {
  const Eigen::Vector3d p = point_in_left_mm / kMillimetresPerMetre;
  const Eigen::MatrixXd dp = impl_->TriangulationJacobian(left, right, point_in_left_mm) -
                             FixedPointMotion(p, false) * impl_->Gain(left);
  return impl_->Covariance(dp) * (kMillimetresPerMetre * kMillimetresPerMetre);
}

double ProjectionUncertainty::LengthVariance(int left, int right,
                                             const Eigen::Vector3d& a_in_left_mm,
                                             const Eigen::Vector3d& b_in_left_mm) const {
  const Eigen::Vector3d along = (a_in_left_mm - b_in_left_mm).normalized();
  if (!along.allFinite() || along.norm() < 0.5) {
    throw InputError("projection uncertainty: a length needs two different points");
  }
  const Eigen::MatrixXd dl =
      along.transpose() * (impl_->TriangulationJacobian(left, right, a_in_left_mm) -
                           impl_->TriangulationJacobian(left, right, b_in_left_mm));
  return impl_->Covariance(dl)(0, 0) * (kMillimetresPerMetre * kMillimetresPerMetre);
}

}  // namespace plumbline
