#include "calib/internal/mrcal_bridge.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace plumbline::internal {
namespace {

constexpr double kMetresPerMm = 1e-3;
constexpr double kMaxCellsPerPoint =
    4;  // asymmetric grids leave every second cell empty; more than that is not worth a grid

// Where the points of a board lie in a regular grid of cells.
struct Grid {
  int columns = 0, rows = 0;
  double spacing_mm = 0;
  std::vector<Eigen::Vector2i> cell;  // (column, row) by id
};

std::optional<Grid> FitGrid(const std::vector<Eigen::Vector3d>& nominal_mm) {
  Grid grid;
  grid.spacing_mm = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector3d& p : nominal_mm) {
    for (double v : {p.x(), p.y()}) {
      if (v > 1e-9) grid.spacing_mm = std::min(grid.spacing_mm, v);
    }
  }
  Eigen::Vector2i last = Eigen::Vector2i::Zero();
  for (const Eigen::Vector3d& p : nominal_mm) {
    const Eigen::Vector2d place = p.head<2>() / grid.spacing_mm;
    const Eigen::Vector2i cell = place.array().round().cast<int>();
    if ((place - cell.cast<double>()).norm() > 1e-6 || cell.minCoeff() < 0) return std::nullopt;
    grid.cell.push_back(cell);
    last = last.cwiseMax(cell);
  }
  grid.columns = last.x() + 1;
  grid.rows = last.y() + 1;
  if (grid.columns * grid.rows > kMaxCellsPerPoint * static_cast<double>(nominal_mm.size()))
    return std::nullopt;
  return grid;
}

Eigen::Matrix<double, 1, 6> ToRt(const Rigid3& motion) {
  Eigen::Matrix<double, 1, 6> rt;
  rt << motion.RotationVector().transpose(), kMetresPerMm * motion.translation_mm.transpose();
  return rt;
}

Rigid3 FromRt(const Eigen::Matrix<double, 1, 6>& rt) {
  return Rigid3::FromRotationVector(rt.head<3>().transpose(),
                                    rt.tail<3>().transpose() / kMetresPerMm);
}

// Pairs in use, in order, and which (pair, camera) rows the observations form.
struct Rows {
  std::map<int, int> frame_of_pair;
  std::map<std::pair<int, int>, int> row;  // (frame, camera) -> board observation

  explicit Rows(const BoardProblem& problem) {
    for (const BoardObservation& o : problem.observations) frame_of_pair.emplace(o.pair, 0);
    int frame = 0;
    for (auto& [pair, index] : frame_of_pair) index = frame++;
    for (const BoardObservation& o : problem.observations)
      row.emplace(std::make_pair(frame_of_pair.at(o.pair), o.camera), 0);
    int i = 0;
    for (auto& [key, index] : row) index = i++;
  }
};

// The digits of a solution that are the same every time: libmrcal factorises on a threaded BLAS,
// whose last bits are not. The joint adjustment that follows is deterministic, so that a start
// without those bits gives the same result, bit for bit.
double Rounded(double value) {
  if (value == 0 || !std::isfinite(value)) return value;
  const double unit = std::pow(10.0, std::floor(std::log10(std::abs(value))) - 5);
  return std::round(value / unit) * unit;
}

}  // namespace

std::optional<OptimizationInputs> ToOptimizationInputs(const BoardProblem& problem) {
  const std::optional<Grid> grid = FitGrid(problem.nominal_mm);
  if (!grid) return std::nullopt;
  const Rows rows(problem);
  OptimizationInputs in;
  in.lens_model = problem.rig.left.model();
  in.image_sizes = {problem.rig.left.size(), problem.rig.right.size()};
  in.intrinsics.resize(2, problem.rig.left.parameter_count());
  in.intrinsics << problem.rig.left.parameters().transpose(),
      problem.rig.right.parameters().transpose();
  in.extrinsics_rt_fromref = ToRt(problem.rig.right_from_left);
  in.frames_rt_toref.resize(static_cast<Eigen::Index>(rows.frame_of_pair.size()), 6);
  for (const auto& [pair, frame] : rows.frame_of_pair)
    in.frames_rt_toref.row(frame) = ToRt(problem.left_from_board[static_cast<std::size_t>(pair)]);
  in.board_columns = grid->columns;
  in.board_rows = grid->rows;
  in.calibration_object_spacing = grid->spacing_mm * kMetresPerMm;
  in.indices_frame_camintrinsics_camextrinsics.resize(static_cast<Eigen::Index>(rows.row.size()),
                                                      3);
  for (const auto& [key, row] : rows.row)
    in.indices_frame_camintrinsics_camextrinsics.row(row) << key.first, key.second, key.second - 1;
  in.observations_board = OptimizationInputs::RowMatrix3::Constant(
      static_cast<Eigen::Index>(rows.row.size()) * grid->rows * grid->columns, 3, -1);

  const std::vector<Eigen::Vector2d> residuals = Residuals(problem);
  BoardProblem flat = problem;
  flat.target_mm = flat.nominal_mm;
  const std::vector<Eigen::Vector2d> flat_residuals = Residuals(flat);
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const BoardObservation& o = problem.observations[i];
    const Eigen::Vector2i cell = grid->cell[static_cast<std::size_t>(o.id)];
    const int row = rows.row.at({rows.frame_of_pair.at(o.pair), o.camera});
    // flat_residual = pixel - offset - predicted(nominal), so predicted(nominal) + residual is the
    // pixel a flat board would show.
    const Eigen::Vector2d pixel = o.pixel - o.disc_offset_px - flat_residuals[i] + residuals[i];
    in.observations_board.row(in.CornerRow(row, cell.y(), cell.x())) << pixel.x(), pixel.y(),
        o.outlier ? -1.0 : 1.0;
  }
  // A spline can imitate its own core, and has control points that nothing else holds.
  in.do_optimize_intrinsics_core = !in.lens_model.IsSplined();
  in.do_apply_regularization = in.lens_model.IsSplined();
  in.do_apply_outlier_rejection = false;
  return in;
}

void TakeSolution(const OptimizationInputs& solved, BoardProblem& problem) {
  const std::optional<Grid> grid = FitGrid(problem.nominal_mm);
  const Rows rows(problem);
  problem.rig.left =
      problem.rig.left.WithParameters(solved.intrinsics.row(0).transpose().unaryExpr(&Rounded));
  problem.rig.right =
      problem.rig.right.WithParameters(solved.intrinsics.row(1).transpose().unaryExpr(&Rounded));
  problem.rig.right_from_left = FromRt(solved.extrinsics_rt_fromref.row(0).unaryExpr(&Rounded));
  for (const auto& [pair, frame] : rows.frame_of_pair)
    problem.left_from_board[static_cast<std::size_t>(pair)] =
        FromRt(solved.frames_rt_toref.row(frame).unaryExpr(&Rounded));
  for (BoardObservation& o : problem.observations) {
    const Eigen::Vector2i cell = grid->cell[static_cast<std::size_t>(o.id)];
    const int row = rows.row.at({rows.frame_of_pair.at(o.pair), o.camera});
    o.outlier = solved.observations_board(solved.CornerRow(row, cell.y(), cell.x()), 2) < 0;
  }
}

}  // namespace plumbline::internal
