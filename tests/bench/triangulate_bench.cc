#include <benchmark/benchmark.h>

#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>
#include <random>
#include <vector>

#include "calib/mode_triangulation.h"
#include "calib/triangulate.h"

namespace plumbline {
namespace {

constexpr int kPoints = 200'000;

StereoRig MakeRig() {
  Eigen::VectorXd p(9);
  p << 6640, 6640, 960, 600, -0.05, 0.3, 1e-3, -7e-4, 0.01;
  const Camera camera(LensModel::FromName("opencv5"), {1920, 1200}, p);
  return {camera, camera, Rigid3::FromRotationVector({0.01, 0.33, -0.02}, {-121, 2, 20}), {}, ""};
}

struct Scene {
  StereoRig rig = MakeRig();
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector2d> left, right;
  std::vector<StereoObservation> observations;

  Scene() {
    std::mt19937 rng(1);
    std::uniform_real_distribution<double> x(-45, 45), y(-28, 28), z(375, 392);
    for (int i = 0; i < kPoints; ++i) {
      points.emplace_back(x(rng), y(rng), z(rng));
      left.push_back(rig.left.Project(points.back()));
      right.push_back(rig.right.Project(rig.right_from_left * points.back()));
      observations.push_back({left.back(), right.back(), Eigen::Matrix4d::Identity() * 1e-4});
    }
  }

  bool IsRight(std::size_t i, const Eigen::Vector3d& point, double tolerance_mm) const {
    return (point - points[i]).norm() < tolerance_mm;
  }
};

const Scene& TheScene() {
  static const Scene scene;
  return scene;
}

void TriangulatePointsAlone(benchmark::State& state) {
  const Scene& scene = TheScene();
  for (auto _ : state) {
    const auto points = TriangulatePoints(scene.rig, scene.left, scene.right);
    state.PauseTiming();
    for (std::size_t i = 0; i < points.size(); i += 997) {
      if (!scene.IsRight(i, points[i], 1e-7)) state.SkipWithError("a wrong point");
    }
    state.ResumeTiming();
  }
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(TriangulatePointsAlone)->Unit(benchmark::kMillisecond)->UseRealTime();

void TriangulateWithCovariance(benchmark::State& state) {
  const Scene& scene = TheScene();
  for (auto _ : state) {
    const auto points = Triangulate(scene.rig, scene.observations);
    state.PauseTiming();
    for (std::size_t i = 0; i < points.size(); i += 997) {
      if (!scene.IsRight(i, points[i].point_in_rig, 1e-7)) state.SkipWithError("a wrong point");
    }
    state.ResumeTiming();
  }
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(TriangulateWithCovariance)->Unit(benchmark::kMillisecond)->UseRealTime();

// Twelve modes, each of which moves lenses and pose.
StereoRig RigWithModes() {
  StereoRig rig = MakeRig();
  rig.modes.modes.resize(12, rig.ParameterCount());
  std::mt19937 rng(2);
  std::normal_distribution<double> normal(0, 1);
  for (Eigen::Index i = 0; i < rig.modes.modes.size(); ++i) {
    rig.modes.modes.data()[i] = 1e-4 * normal(rng);
  }
  rig.modes.modes.leftCols<4>() *= 1e4;
  return rig;
}

constexpr std::size_t kModePoints = 19'000;

void DifferencesAlongModes(benchmark::State& state) {
  const Scene& scene = TheScene();
  const StereoRig rig = RigWithModes();
  const auto left = std::span(scene.left).first(kModePoints);
  const auto right = std::span(scene.right).first(kModePoints);
  const ModeTriangulation modes(rig);
  const auto count = static_cast<std::size_t>(modes.count());
  std::vector<Eigen::Vector3f> differences(kModePoints * count);
  modes.Differences(left, right, differences);
  const auto nominal = TriangulatePoints(rig, left, right);
  for (int k = 0; k < modes.count(); ++k) {
    const auto moved = TriangulatePoints(rig.AlongMode(k), left, right);
    for (std::size_t i = 0; i < kModePoints; i += 97) {
      const Eigen::Vector3d expected = moved[i] - nominal[i];
      const Eigen::Vector3f& found = differences[i * count + static_cast<std::size_t>(k)];
      if (!((found.cast<double>() - expected).norm() < 1e-3 * expected.norm() + 1e-4)) {
        state.SkipWithError("a wrong difference");
      }
    }
  }
  for (auto _ : state) modes.Differences(left, right, differences);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kModePoints * count));
}
BENCHMARK(DifferencesAlongModes)->Unit(benchmark::kMillisecond)->UseRealTime();

// The baseline of the one above.
void TriangulatePointsAlongModes(benchmark::State& state) {
  const Scene& scene = TheScene();
  const StereoRig rig = RigWithModes();
  const auto left = std::span(scene.left).first(kModePoints);
  const auto right = std::span(scene.right).first(kModePoints);
  for (auto _ : state) {
    for (int k = 0; k < rig.modes.count(); ++k) {
      benchmark::DoNotOptimize(TriangulatePoints(rig.AlongMode(k), left, right));
    }
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kModePoints) *
                          rig.modes.count());
}
BENCHMARK(TriangulatePointsAlongModes)->Unit(benchmark::kMillisecond)->UseRealTime();

void MakeTablesOfModes(benchmark::State& state) {
  const StereoRig rig = RigWithModes();
  for (auto _ : state) benchmark::DoNotOptimize(ModeTriangulation(rig));
}
BENCHMARK(MakeTablesOfModes)->Unit(benchmark::kMillisecond)->UseRealTime();

// The baseline: OpenCV's undistortion (iterated until it is as good as ours) and linear
// triangulation, which gives points without covariance.
void OpenCvTriangulatePoints(benchmark::State& state) {
  const Scene& scene = TheScene();
  const Eigen::VectorXd& p = scene.rig.left.parameters();
  const cv::Mat K = (cv::Mat_<double>(3, 3) << p[0], 0, p[2], 0, p[1], p[3], 0, 0, 1);
  const cv::Mat distortion = (cv::Mat_<double>(1, 5) << p[4], p[5], p[6], p[7], p[8]);
  const Rigid3& T = scene.rig.right_from_left;
  cv::Mat P0 = cv::Mat::eye(3, 4, CV_64F), P1(3, 4, CV_64F);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) P1.at<double>(r, c) = T.rotation(r, c);
    P1.at<double>(r, 3) = T.translation_mm[r];
  }
  std::vector<cv::Point2d> left, right;
  for (std::size_t i = 0; i < scene.left.size(); ++i) {
    left.emplace_back(scene.left[i].x(), scene.left[i].y());
    right.emplace_back(scene.right[i].x(), scene.right[i].y());
  }
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-9);
  for (auto _ : state) {
    std::vector<cv::Point2d> u0, u1;
    cv::undistortPoints(left, u0, K, distortion, cv::noArray(), cv::noArray(), until);
    cv::undistortPoints(right, u1, K, distortion, cv::noArray(), cv::noArray(), until);
    cv::Mat X;
    cv::triangulatePoints(P0, P1, u0, u1, X);
    state.PauseTiming();
    for (int i = 0; i < kPoints; i += 997) {
      const double w = X.at<double>(3, i);
      const Eigen::Vector3d point(X.at<double>(0, i) / w, X.at<double>(1, i) / w,
                                  X.at<double>(2, i) / w);
      if (!scene.IsRight(static_cast<std::size_t>(i), point, 1e-5)) {
        state.SkipWithError("a wrong point");
      }
    }
    state.ResumeTiming();
  }
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(OpenCvTriangulatePoints)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace plumbline
