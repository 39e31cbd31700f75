#include <benchmark/benchmark.h>

#include <opencv2/calib3d.hpp>
#include <random>
#include <vector>

#include "calib/camera.h"

namespace plumbline {
namespace {

constexpr int kPoints = 200'000;

Camera MakeCamera(bool splined) {
  const LensModel model = LensModel::FromName(
      splined ? "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=11_fov_x_deg=80" : "OPENCV5");
  Eigen::VectorXd p = Eigen::VectorXd::Zero(model.ParameterCount());
  p.head<4>() << 1500, 1505, 960, 600;
  if (splined) {
    for (Eigen::Index i = 4; i < p.size(); ++i) p[i] = 0.003 * std::sin(static_cast<double>(i));
  } else {
    p.tail<5>() << -0.1, 0.05, 1e-3, -7e-4, 0.01;
  }
  return Camera(model, {1920, 1200}, p);
}

std::vector<Eigen::Vector2d> Pixels() {
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> x(0, 1919), y(0, 1199);
  std::vector<Eigen::Vector2d> pixels(kPoints);
  for (Eigen::Vector2d& q : pixels) q = {x(rng), y(rng)};
  return pixels;
}

double LargestDifference(const std::vector<Eigen::Vector2d>& a,
                         const std::vector<Eigen::Vector2d>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, (a[i] - b[i]).norm());
  return largest;
}

void Project(benchmark::State& state) {
  const Camera camera = MakeCamera(state.range(0) != 0);
  const auto pixels = Pixels();
  std::vector<Eigen::Vector3d> rays(pixels.size());
  std::vector<Eigen::Vector2d> projected(pixels.size());
  camera.Unproject(pixels, rays);
  for (auto _ : state) camera.Project(rays, projected);
  if (!(LargestDifference(projected, pixels) < 2e-9)) state.SkipWithError("a wrong pixel");
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(Project)
    ->ArgName("splined")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

void Unproject(benchmark::State& state) {
  const Camera camera = MakeCamera(state.range(0) != 0);
  const auto pixels = Pixels();
  std::vector<Eigen::Vector3d> rays(pixels.size());
  std::vector<Eigen::Vector2d> projected(pixels.size());
  for (auto _ : state) camera.Unproject(pixels, rays);
  camera.Project(rays, projected);
  if (!(LargestDifference(projected, pixels) < 2e-9)) state.SkipWithError("a wrong ray");
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(Unproject)
    ->ArgName("splined")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

// The baseline: OpenCV on the same lens and points, iterated until it is as good as ours.
void OpenCvUndistortPoints(benchmark::State& state) {
  const Camera camera = MakeCamera(false);
  const Eigen::VectorXd& p = camera.parameters();
  const cv::Mat K = (cv::Mat_<double>(3, 3) << p[0], 0, p[2], 0, p[1], p[3], 0, 0, 1);
  const cv::Mat distortion = (cv::Mat_<double>(1, 5) << p[4], p[5], p[6], p[7], p[8]);
  const auto pixels = Pixels();
  std::vector<cv::Point2d> q, undistorted;
  for (const Eigen::Vector2d& pixel : pixels) q.emplace_back(pixel.x(), pixel.y());
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-9);
  for (auto _ : state) {
    cv::undistortPoints(q, undistorted, K, distortion, cv::noArray(), cv::noArray(), until);
  }
  std::vector<Eigen::Vector3d> rays;
  for (const cv::Point2d& u : undistorted) rays.emplace_back(u.x, u.y, 1);
  std::vector<Eigen::Vector2d> projected(pixels.size());
  camera.Project(rays, projected);
  if (!(LargestDifference(projected, pixels) < 1e-7)) state.SkipWithError("a wrong ray");
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(OpenCvUndistortPoints)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace plumbline
