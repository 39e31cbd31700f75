#include <benchmark/benchmark.h>

#include <cmath>
#include <opencv2/calib3d.hpp>
#include <vector>

#include "calib/calibrate.h"
#include "tests/support/synthetic_boards.h"

namespace plumbline {
namespace {

using testing::SyntheticBoards;

const SyntheticBoards& Boards() {
  static const SyntheticBoards boards = testing::MakeSyntheticBoards();
  return boards;
}

bool IsRight(double baseline_mm) {
  return std::abs(baseline_mm - Boards().truth.baseline_mm()) < 0.1;
}

// Everything, from points to modes: the board refined, the covariance clustered. Items are observed
// points.
void CalibrateWithCovariance(benchmark::State& state) {
  const testing::SyntheticBoardsOptions made;
  CalibrationOptions options;
  options.model = LensModel::FromName("OPENCV5");
  options.compare_halves = false;
  std::int64_t points = 0;
  for (auto _ : state) {
    const Calibration c = Calibrate(made.board, {1280, 960}, {1280, 960}, Boards().pairs, options);
    if (!IsRight(c.rig.baseline_mm())) state.SkipWithError("wrong baseline");
    points += c.point_count;
  }
  state.SetItemsProcessed(points);
}
BENCHMARK(CalibrateWithCovariance)->Unit(benchmark::kMillisecond);

// The baseline: OpenCV, each camera alone and then both, a rigid board, no covariance.
void OpenCvStereoCalibrate(benchmark::State& state) {
  const testing::SyntheticBoardsOptions made;
  std::vector<std::vector<cv::Point3f>> object;
  std::vector<std::vector<cv::Point2f>> left, right;
  std::int64_t count = 0;
  for (const CalibrationPair& pair : Boards().pairs) {
    object.emplace_back();
    left.emplace_back();
    right.emplace_back();
    std::size_t r = 0;
    for (std::size_t l = 0; l < pair.left.ids.size(); ++l) {
      while (r < pair.right.ids.size() && pair.right.ids[r] < pair.left.ids[l]) ++r;
      if (r == pair.right.ids.size() || pair.right.ids[r] != pair.left.ids[l]) continue;
      const Eigen::Vector3f p = made.board.NominalPoint(pair.left.ids[l]).cast<float>();
      object.back().emplace_back(p.x(), p.y(), p.z());
      left.back().emplace_back(static_cast<float>(pair.left.pixels[l].x()),
                               static_cast<float>(pair.left.pixels[l].y()));
      right.back().emplace_back(static_cast<float>(pair.right.pixels[r].x()),
                                static_cast<float>(pair.right.pixels[r].y()));
      count += 2;
    }
  }
  const cv::Size size(1280, 960);
  for (auto _ : state) {
    cv::Mat K1, D1, K2, D2, R, T, E, F;
    std::vector<cv::Mat> rotations, translations;
    cv::calibrateCamera(object, left, size, K1, D1, rotations, translations);
    cv::calibrateCamera(object, right, size, K2, D2, rotations, translations);
    cv::stereoCalibrate(
        object, left, right, K1, D1, K2, D2, size, R, T, E, F, cv::CALIB_USE_INTRINSIC_GUESS,
        cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 60, 1e-9));
    if (!IsRight(cv::norm(T))) state.SkipWithError("wrong baseline");
  }
  state.SetItemsProcessed(state.iterations() * count);
}
BENCHMARK(OpenCvStereoCalibrate)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace plumbline
