#include "calib/internal/mrcal_solver.h"

#include <cholmod.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "calib/error.h"
#include "calib/internal/mrcal.h"

namespace plumbline::internal {
namespace {

// The arrays of OptimizationInputs in the shapes libmrcal's C functions take, and back.
struct MrcalProblem {
  explicit MrcalProblem(const OptimizationInputs& in)
      : cameras(in.camera_count()),
        extrinsics_count(static_cast<int>(in.extrinsics_rt_fromref.rows())),
        frames_count(in.frame_count()),
        points_count(static_cast<int>(in.points.rows())),
        fixed_points(in.fixed_points),
        rows(in.board_rows),
        columns(in.board_columns),
        spacing(in.calibration_object_spacing),
        lens_model(ToMrcal(in.lens_model)),
        intrinsics(in.intrinsics) {
    selections.do_optimize_intrinsics_core = in.do_optimize_intrinsics_core;
    selections.do_optimize_intrinsics_distortions = in.do_optimize_intrinsics_distortions;
    selections.do_optimize_extrinsics = in.do_optimize_extrinsics;
    selections.do_optimize_frames = in.do_optimize_frames;
    selections.do_optimize_calobject_warp = in.do_optimize_calobject_warp;
    selections.do_apply_regularization = in.do_apply_regularization;
    selections.do_apply_outlier_rejection = in.do_apply_outlier_rejection;
    constants.point_min_range = in.point_min_range;
    constants.point_max_range = in.point_max_range;
    for (const ImageSize& size : in.image_sizes) {
      image_sizes.push_back(size.width);
      image_sizes.push_back(size.height);
    }
    CopyRows(in.extrinsics_rt_fromref, extrinsics);
    CopyRows(in.frames_rt_toref, frames);
    CopyRows(in.points, points);
    CopyRows(in.observations_board, pool);
    warp.x2 = in.calobject_warp ? (*in.calobject_warp)[0] : 0;
    warp.y2 = in.calobject_warp ? (*in.calobject_warp)[1] : 0;
    const auto& ib = in.indices_frame_camintrinsics_camextrinsics;
    for (Eigen::Index o = 0; o < ib.rows(); ++o) {
      boards.push_back({{ib(o, 1), ib(o, 2)}, ib(o, 0)});
    }
    const auto& ip = in.indices_point_camintrinsics_camextrinsics;
    for (Eigen::Index o = 0; o < ip.rows(); ++o) {
      mrcal_observation_point_t observation{{ip(o, 1), ip(o, 2)}, ip(o, 0), {}};
      for (int k = 0; k < 3; ++k) observation.px.xyz[k] = in.observations_point(o, k);
      point_observations.push_back(observation);
    }
  }

  template <typename Matrix, typename T>
  static void CopyRows(const Matrix& from, std::vector<T>& to) {
    to.resize(static_cast<std::size_t>(from.rows()));
    if (!to.empty()) std::memcpy(to.data(), from.data(), to.size() * sizeof(T));
  }
  template <typename Matrix, typename T>
  static void CopyBack(const std::vector<T>& from, Matrix& to) {
    if (!from.empty()) std::memcpy(to.data(), from.data(), from.size() * sizeof(T));
  }

  void Store(OptimizationInputs& out) const {
    out.intrinsics = intrinsics;
    CopyBack(extrinsics, out.extrinsics_rt_fromref);
    CopyBack(frames, out.frames_rt_toref);
    CopyBack(points, out.points);
    CopyBack(pool, out.observations_board);
    if (selections.do_optimize_calobject_warp)
      out.calobject_warp = Eigen::Vector2d(warp.x2, warp.y2);
  }

  int board_count() const { return static_cast<int>(boards.size()); }
  int point_count() const { return static_cast<int>(point_observations.size()); }

  int cameras, extrinsics_count, frames_count, points_count, fixed_points, rows, columns;
  double spacing;
  mrcal_lensmodel_t lens_model;
  mrcal_problem_selections_t selections{};
  mrcal_problem_constants_t constants{};
  std::vector<int> image_sizes;
  OptimizationInputs::RowMatrix intrinsics;
  std::vector<mrcal_pose_t> extrinsics, frames;
  std::vector<mrcal_point3_t> points, pool;
  mrcal_calobject_warp_t warp{};
  std::vector<mrcal_observation_board_t> boards;
  std::vector<mrcal_observation_point_t> point_observations;
};

StateLayout LayoutOf(const MrcalProblem& p) {
  StateLayout s;
  const auto& sel = p.selections;
  const auto* model = &p.lens_model;
  const int boards = p.board_count(), points = p.point_count();
  s.state_count = mrcal_num_states(p.cameras, p.extrinsics_count, p.frames_count, p.points_count,
                                   p.fixed_points, boards, sel, model);
  s.intrinsics_per_camera = mrcal_num_intrinsics_optimization_params(sel, model);
  s.first_intrinsic = sel.do_optimize_intrinsics_core ? 0 : 4;
  const auto index = [&](auto function, int i, int count) {
    return count == 0 ? -1
                      : function(i, p.cameras, p.extrinsics_count, p.frames_count, p.points_count,
                                 p.fixed_points, boards, sel, model);
  };
  s.intrinsics =
      s.intrinsics_per_camera == 0 ? -1 : index(mrcal_state_index_intrinsics, 0, p.cameras);
  s.extrinsics =
      index(mrcal_state_index_extrinsics, 0, sel.do_optimize_extrinsics ? p.extrinsics_count : 0);
  s.frames = index(mrcal_state_index_frames, 0, sel.do_optimize_frames ? p.frames_count : 0);
  s.points = index(mrcal_state_index_points, 0,
                   sel.do_optimize_frames ? p.points_count - p.fixed_points : 0);
  if (mrcal_num_states_calobject_warp(sel, boards) > 0) {
    s.calobject_warp =
        mrcal_state_index_calobject_warp(p.cameras, p.extrinsics_count, p.frames_count,
                                         p.points_count, p.fixed_points, boards, sel, model);
  }
  s.measurement_count =
      mrcal_num_measurements(boards, points, p.columns, p.rows, p.cameras, p.extrinsics_count,
                             p.frames_count, p.points_count, p.fixed_points, sel, model);
  s.board_measurements = mrcal_num_measurements_boards(boards, p.columns, p.rows);
  s.point_measurements = mrcal_num_measurements_points(points);
  s.regularization_measurements =
      mrcal_num_measurements_regularization(p.cameras, p.extrinsics_count, p.frames_count,
                                            p.points_count, p.fixed_points, boards, sel, model);
  return s;
}

int OutlierCount(const OptimizationInputs& inputs) {
  return static_cast<int>((inputs.observations_board.col(2).array() < 0).count());
}

// Why an optimum cannot be a calibration; empty if it can.
std::string JudgeCameras(const OptimizationInputs& inputs) {
  if (!inputs.intrinsics.allFinite() || !inputs.extrinsics_rt_fromref.allFinite() ||
      !inputs.frames_rt_toref.allFinite() || !inputs.points.allFinite()) {
    return "the solve did not converge: a parameter is not finite";
  }
  for (int c = 0; c < inputs.camera_count(); ++c) {
    const ImageSize size = inputs.image_sizes[static_cast<std::size_t>(c)];
    const double width = std::max(size.width, size.height);
    for (int k = 0; k < 2; ++k) {
      const double focal = inputs.intrinsics(c, k);
      if (!(focal > 0.1 * width && focal < 1000 * width)) {
        return "the solve collapsed: camera " + std::to_string(c) +
               " came out with a focal length of " + std::to_string(focal) + " px";
      }
      const double centre = inputs.intrinsics(c, 2 + k);
      const double extent = k == 0 ? size.width : size.height;
      if (!(centre > -width && centre < extent + width)) {
        return "the solve collapsed: camera " + std::to_string(c) +
               " came out with its principal point at " + std::to_string(centre) + " px";
      }
    }
  }
  return "";
}

}  // namespace

StateLayout LayoutOf(const OptimizationInputs& inputs) { return LayoutOf(MrcalProblem(inputs)); }

MrcalSolveResult SolveWithMrcal(OptimizationInputs& inputs) {
  inputs.Check();
  MrcalProblem p(inputs);
  const StateLayout layout = LayoutOf(p);
  const int outliers_before = OutlierCount(inputs);
  MrcalSolveResult result;
  const int known = 2 * (static_cast<int>(inputs.observations_board.rows()) - outliers_before) +
                    2 * p.point_count() + layout.regularization_measurements;
  if (layout.state_count == 0 || known <= layout.state_count) {
    result.outlier_count = outliers_before;
    result.problem = "the solve has more unknowns (" + std::to_string(layout.state_count) +
                     ") than observed coordinates (" + std::to_string(known) +
                     "): more photographs of the board are needed";
    return result;
  }
  const int corners = static_cast<int>(inputs.observations_board.rows());
  Eigen::VectorXd b(layout.state_count), x(layout.measurement_count);
  mrcal_optimize(b.data(), static_cast<int>(b.size() * sizeof(double)), x.data(),
                 static_cast<int>(x.size() * sizeof(double)), p.intrinsics.data(),
                 p.extrinsics.data(), p.frames.data(), p.points.data(), &p.warp, p.cameras,
                 p.extrinsics_count, p.frames_count, p.points_count, p.fixed_points,
                 p.boards.data(), p.point_observations.data(), p.board_count(), p.point_count(),
                 p.pool.data(), &p.lens_model, p.image_sizes.data(), p.selections, &p.constants,
                 p.spacing, p.columns, p.rows, false, false);
  p.Store(inputs);

  result.outlier_count = OutlierCount(inputs);
  result.new_outlier_count = result.outlier_count - outliers_before;
  result.inlier_count = corners - result.outlier_count;
  // Residuals of outliers are 0 in x.
  result.rms_px = std::sqrt(x.head(layout.board_measurements).squaredNorm() /
                            std::max(1.0, 2.0 * result.inlier_count));
  result.problem = JudgeCameras(inputs);
  if (result.problem.empty() && !std::isfinite(result.rms_px)) {
    result.problem = "the solve did not converge: its residuals are not finite";
  }
  if (result.problem.empty() && corners > 0 &&
      (result.inlier_count < 4 * inputs.board_observation_count() ||
       2 * result.new_outlier_count > corners - outliers_before)) {
    result.problem = "the solve threw out " + std::to_string(result.new_outlier_count) + " of " +
                     std::to_string(corners - outliers_before) +
                     " corners: it did not find what the photographs have in common";
  }
  return result;
}

OptimizerState OptimizerCallback(const OptimizationInputs& inputs) {
  inputs.Check();
  MrcalProblem p(inputs);
  OptimizerState out;
  out.layout = LayoutOf(p);
  const int states = out.layout.state_count, measurements = out.layout.measurement_count;
  const int nonzeros = _mrcal_num_j_nonzero(
      p.board_count(), p.point_count(), p.columns, p.rows, p.cameras, p.extrinsics_count,
      p.frames_count, p.points_count, p.fixed_points, p.boards.data(), p.point_observations.data(),
      p.selections, &p.lens_model);

  // libmrcal fills the transpose by columns, which is J itself by rows.
  out.x.resize(measurements);
  out.b_packed.resize(states);
  std::vector<int> starts(static_cast<std::size_t>(measurements) + 1);
  std::vector<int> indices(static_cast<std::size_t>(nonzeros));
  std::vector<double> values(static_cast<std::size_t>(nonzeros));
  cholmod_sparse Jt{};
  Jt.nrow = static_cast<std::size_t>(states);
  Jt.ncol = static_cast<std::size_t>(measurements);
  Jt.nzmax = static_cast<std::size_t>(nonzeros);
  Jt.p = starts.data();
  Jt.i = indices.data();
  Jt.x = values.data();
  Jt.stype = 0;
  Jt.itype = CHOLMOD_INT;
  Jt.xtype = CHOLMOD_REAL;
  Jt.dtype = CHOLMOD_DOUBLE;
  Jt.sorted = 1;
  Jt.packed = 1;
  const bool ok = mrcal_optimizer_callback(
      out.b_packed.data(), static_cast<int>(out.b_packed.size() * sizeof(double)), out.x.data(),
      static_cast<int>(out.x.size() * sizeof(double)), &Jt, p.intrinsics.data(),
      p.extrinsics.data(), p.frames.data(), p.points.data(), &p.warp, p.cameras, p.extrinsics_count,
      p.frames_count, p.points_count, p.fixed_points, p.boards.data(), p.point_observations.data(),
      p.board_count(), p.point_count(), p.pool.data(), &p.lens_model, p.image_sizes.data(),
      p.selections, &p.constants, p.spacing, p.columns, p.rows, false);
  if (!ok) throw InputError("optimization inputs: libmrcal refused the problem");

  out.J = Eigen::Map<const Eigen::SparseMatrix<double, Eigen::RowMajor>>(
      measurements, states, starts.back(), starts.data(), indices.data(), values.data());
  out.unpack_scale = Eigen::VectorXd::Ones(states);
  mrcal_unpack_solver_state_vector(out.unpack_scale.data(), p.cameras, p.extrinsics_count,
                                   p.frames_count, p.points_count, p.fixed_points, p.selections,
                                   &p.lens_model);
  return out;
}

}  // namespace plumbline::internal
