// Board detection on rendered photographs, beside OpenCV's own finders on the same ones. Each first
// checks that the points are right.
#include <benchmark/benchmark.h>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>

#include "calib/board.h"
#include "calib/internal/opencv_image.h"
#include "tests/support/synthetic_board.h"

namespace plumbline {
namespace {

constexpr double kRadiusMm = 1.4;

testing::SyntheticPhoto Photo(const char* word, double px_per_mm) {
  const BoardSpec spec = BoardSpec::Parse(word);
  testing::SyntheticPhoto photo;
  const bool discs = spec.HasDiscs();
  photo.albedo = discs ? testing::DiscAlbedo(spec, kRadiusMm) : testing::ChessboardAlbedo(spec);
  photo.size = {1280, 960};
  photo.noise = 1.5;
  const Eigen::Vector2d middle =
      (spec.NominalPoint(0) + spec.NominalPoint(spec.PointCount() - 1)).head<2>() / 2;
  photo.image_from_board = testing::BoardHomography(middle, px_per_mm, 6, 15, -10, {640.3, 479.6});
  return photo;
}

void Detect(benchmark::State& state, const char* word, double px_per_mm) {
  const BoardSpec spec = BoardSpec::Parse(word);
  const testing::SyntheticPhoto photo = Photo(word, px_per_mm);
  const GrayImage image = photo.Render();
  const BoardDetection once = DetectBoard(spec, image);
  for (std::size_t k = 0; k < once.ids.size(); ++k) {
    const Eigen::Vector2d p = spec.NominalPoint(once.ids[k]).head<2>();
    const Eigen::Vector2d truth =
        spec.HasDiscs() ? testing::DiscCentroid(photo, p, kRadiusMm) : photo.Map(p);
    if ((once.pixels[k] - truth).norm() > 0.1) state.SkipWithError("wrong point");
  }
  if (static_cast<int>(once.ids.size()) != spec.PointCount()) {
    state.SkipWithError("not all points found");
  }
  for (auto _ : state) benchmark::DoNotOptimize(DetectBoard(spec, image));
  state.SetItemsProcessed(state.iterations() * spec.PointCount());
}
BENCHMARK_CAPTURE(Detect, donut_dots, "donut-dots:14x10:7mm", 9.0)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Detect, circles, "circles:14x10:7mm", 9.0)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Detect, chessboard, "chessboard:12x8:7mm", 9.0)->Unit(benchmark::kMillisecond);

void OpenCvCirclesGrid(benchmark::State& state) {
  const GrayImage image = Photo("circles:14x10:7mm", 9).Render();
  const cv::Mat grey = internal::ToMat8(image);
  std::vector<cv::Point2f> points;
  for (auto _ : state) {
    if (!cv::findCirclesGrid(grey, {14, 10}, points)) state.SkipWithError("not found");
  }
  state.SetItemsProcessed(state.iterations() * 140);
}
BENCHMARK(OpenCvCirclesGrid)->Unit(benchmark::kMillisecond);

void OpenCvChessboard(benchmark::State& state) {
  const GrayImage image = Photo("chessboard:12x8:7mm", 9).Render();
  const cv::Mat grey = internal::ToMat8(image);
  std::vector<cv::Point2f> points;
  for (auto _ : state) {
    if (!cv::findChessboardCornersSB(grey, {12, 8}, points)) state.SkipWithError("not found");
  }
  state.SetItemsProcessed(state.iterations() * 96);
}
BENCHMARK(OpenCvChessboard)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace plumbline
