#include "tests/support/synthetic_calibration.h"

#include <cmath>
#include <random>

#include "calib/rigid3.h"

namespace plumbline::testing {
namespace {

constexpr double kSpacing_m = 0.012;

Rigid3 PoseOf(const OptimizationInputs::RowMatrix6& rt, Eigen::Index row) {
  return Rigid3::FromRotationVector(rt.row(row).head<3>().transpose(),
                                    rt.row(row).tail<3>().transpose());
}

Eigen::MatrixXd TrueIntrinsics(const LensModel& model) {
  Eigen::MatrixXd intrinsics = Eigen::MatrixXd::Zero(2, model.ParameterCount());
  intrinsics.row(0).head<4>() << 610, 612, 318, 243;
  intrinsics.row(1).head<4>() << 604, 603, 325, 236;
  if (model.IsSplined()) return intrinsics;
  const double left[] = {-0.11, 0.06, 4e-4, -3e-4, -0.01, 0.01, 0.005, 0.002};
  const double right[] = {-0.09, 0.04, -2e-4, 5e-4, 0.01, 0.02, -0.005, 0.001};
  for (Eigen::Index k = 4; k < intrinsics.cols(); ++k) {
    intrinsics(0, k) = left[k - 4];
    intrinsics(1, k) = right[k - 4];
  }
  return intrinsics;
}

}  // namespace

void SetObservations(const OptimizationInputs& perfect, double noise_px, std::uint64_t seed,
                     OptimizationInputs& inputs) {
  std::mt19937_64 rng(seed);
  std::normal_distribution<double> noise(0, 1);
  const auto& indices = perfect.indices_frame_camintrinsics_camextrinsics;
  for (int o = 0; o < perfect.board_observation_count(); ++o) {
    const Camera camera = perfect.CameraAt(indices(o, 1));
    const Rigid3 ref_from_board = PoseOf(perfect.frames_rt_toref, indices(o, 0));
    const Rigid3 camera_from_ref =
        indices(o, 2) < 0 ? Rigid3() : PoseOf(perfect.extrinsics_rt_fromref, indices(o, 2));
    const Rigid3 camera_from_board = camera_from_ref * ref_from_board;
    for (int r = 0; r < perfect.board_rows; ++r) {
      for (int c = 0; c < perfect.board_columns; ++c) {
        const double spacing = perfect.calibration_object_spacing;
        const Eigen::Vector2d q =
            camera.Project(camera_from_board * Eigen::Vector3d(c * spacing, r * spacing, 0));
        auto row = inputs.observations_board.row(perfect.CornerRow(o, r, c));
        const double dx = noise(rng), dy = noise(rng);
        row << q.x() + noise_px * dx, q.y() + noise_px * dy, 1;
        if (!camera.Contains(q)) row << -1, -1, -1;
      }
    }
  }
}

OptimizationInputs MakeSyntheticCalibration(const SyntheticCalibrationOptions& options) {
  OptimizationInputs in;
  in.lens_model.kind = options.model;
  if (in.lens_model.IsSplined()) {
    in.lens_model.knots_x = 8;
    in.lens_model.knots_y = 6;
    in.lens_model.fov_x_deg = 70;
  }
  in.image_sizes = {{640, 480}, {640, 480}};
  in.intrinsics = TrueIntrinsics(in.lens_model);
  in.extrinsics_rt_fromref.resize(1, 6);
  in.extrinsics_rt_fromref << 0.01, 0.22, -0.015, -0.1, 0.002, 0.012;
  in.board_rows = options.board_rows;
  in.board_columns = options.board_columns;
  in.calibration_object_spacing = kSpacing_m;
  in.do_apply_regularization = false;
  in.do_apply_outlier_rejection = false;
  const int pairs = options.pair_count;
  in.frames_rt_toref.resize(pairs, 6);
  in.indices_frame_camintrinsics_camextrinsics.resize(2 * pairs, 3);
  std::mt19937 rng(20);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int f = 0; f < pairs; ++f) {
    const Eigen::Vector3d r(0.55 * unit(rng), 0.55 * unit(rng), 0.3 * unit(rng));
    const double z = 0.35 + 0.06 * unit(rng);
    const Eigen::Vector3d centre(0.02 + 0.1 * unit(rng), 0.08 * unit(rng), z);
    const Eigen::Vector3d middle((options.board_columns - 1) * kSpacing_m / 2,
                                 (options.board_rows - 1) * kSpacing_m / 2, 0);
    const Eigen::Vector3d t = centre - RotationFromVector(r) * middle;
    in.frames_rt_toref.row(f) << r.transpose(), t.transpose();
    in.indices_frame_camintrinsics_camextrinsics.row(2 * f) << f, 0, -1;
    in.indices_frame_camintrinsics_camextrinsics.row(2 * f + 1) << f, 1, 0;
  }
  in.observations_board.resize(2 * pairs * in.board_rows * in.board_columns, 3);
  const OptimizationInputs perfect = in;
  SetObservations(perfect, options.noise_px, options.seed, in);
  return in;
}

}  // namespace plumbline::testing
