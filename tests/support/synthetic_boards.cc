#include "tests/support/synthetic_boards.h"

#include <cmath>
#include <random>

namespace plumbline::testing {

SyntheticBoardsOptions::SyntheticBoardsOptions() {
  board.kind = BoardSpec::Kind::kChessboard;
  board.columns = 9;
  board.rows = 7;
  board.pitch_mm = 12;
}

SyntheticBoards MakeSyntheticBoards(const SyntheticBoardsOptions& options) {
  const LensModel model = LensModel::FromName("OPENCV5");
  Eigen::VectorXd left(9), right(9);
  left << 2000, 2003, 650, 470, -0.12, 0.15, 4e-4, -3e-4, 0.02;
  right << 2010, 2012, 630, 488, -0.11, 0.12, -2e-4, 5e-4, 0.05;
  const Rigid3 right_from_left = Rigid3::FromRotationVector({0.01, 0.24, -0.005}, {-98, 1.5, 12});
  SyntheticBoards out{{Camera(model, {1280, 960}, left),
                       Camera(model, {1280, 960}, right),
                       right_from_left,
                       {},
                       options.board.Word()},
                      {},
                      {}};

  std::mt19937_64 board_rng(options.board_seed), geometry_rng(99), rng(options.seed);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  const int count = options.board.PointCount();
  for (int id = 0; id < count; ++id) {
    const Eigen::Vector3d p = options.board.NominalPoint(id);
    centre += p / count;
    out.target_mm.push_back(p + options.board_noise_mm * Eigen::Vector3d(normal(board_rng),
                                                                         normal(board_rng),
                                                                         normal(board_rng)));
  }
  for (int pair = 0; pair < options.pair_count; ++pair) {
    Eigen::Vector3d tilt = 0.55 * Eigen::Vector3d(uniform(geometry_rng), uniform(geometry_rng),
                                                  0.6 * uniform(geometry_rng));
    const Eigen::Vector3d place(45 + 25 * uniform(geometry_rng), 20 * uniform(geometry_rng),
                                400 + 50 * uniform(geometry_rng));
    if (options.parallel) tilt.setZero();
    Rigid3 left_from_board = Rigid3::FromRotationVector(tilt, {0, 0, 0});
    left_from_board.translation_mm = place - Eigen::Vector3d(45, 0, 0) + Eigen::Vector3d(20, 0, 0) -
                                     left_from_board.rotation * centre;
    const Eigen::Vector3d bend(normal(rng), normal(rng), normal(rng));
    CalibrationPair shot;
    shot.left_name = "left" + std::to_string(pair);
    shot.right_name = "right" + std::to_string(pair);
    for (int camera : {0, 1}) {
      BoardDetection& detection = camera == 0 ? shot.left : shot.right;
      for (int id = 0; id < count; ++id) {
        Eigen::Vector3d p = out.target_mm[static_cast<std::size_t>(id)];
        const Eigen::Vector2d u = (p - centre).head<2>() / 40;
        p.z() += options.flex_mm *
                 (bend[0] * u.x() * u.x() + bend[1] * u.y() * u.y() + bend[2] * u.x() * u.y());
        const Eigen::Vector3d in_left = left_from_board * p;
        const Eigen::Vector2d pixel = camera == 0
                                          ? out.truth.left.Project(in_left)
                                          : out.truth.right.Project(right_from_left * in_left);
        const Eigen::Vector2d noise(normal(rng), normal(rng));
        if (!out.truth.left.Contains(pixel)) continue;
        detection.ids.push_back(id);
        detection.pixels.push_back(pixel + options.noise_px * noise);
        detection.sigma_px.push_back(std::max(options.noise_px, 1e-3));
      }
    }
    out.pairs.push_back(std::move(shot));
  }
  return out;
}

}  // namespace plumbline::testing
