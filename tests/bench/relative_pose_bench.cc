#include <benchmark/benchmark.h>

#include <random>
#include <vector>

#include "calib/bundle_adjustment.h"
#include "calib/relative_pose.h"

namespace plumbline {
namespace {

constexpr double kNoise_px = 0.01;
constexpr std::size_t kPoints = 1500;

// A rig of 20 degrees at 500 mm with twelve modes, and what it sees after a bump.
struct Scene {
  StereoRig rig;
  std::vector<Eigen::Vector3d> points;
  std::vector<StereoObservation> seen;

  static StereoRig MakeRig() {
    Eigen::VectorXd p(9);
    p << 2500, 2503, 640, 512, -0.12, 0.15, 1e-3, -7e-4, 0.02;
    const Camera camera(LensModel::FromName("opencv5"), {1280, 1024}, p);
    return {
        camera, camera, Rigid3::FromRotationVector({0.01, 0.35, -0.015}, {-171, 2, 31}), {}, ""};
  }

  Scene() : rig(MakeRig()) {
    std::mt19937 rng(1);
    std::normal_distribution<double> normal(0, 1);
    rig.modes.modes.resize(12, rig.ParameterCount());
    for (Eigen::Index i = 0; i < rig.modes.modes.size(); ++i) {
      rig.modes.modes.data()[i] = 1e-5 * normal(rng);
    }
    std::uniform_real_distribution<double> x(-115, 115), y(-90, 90), z(480, 520);
    const Rigid3 right_from_left =
        Rigid3::FromRotationVector({8e-4, 0, 0}, {0, 0, 0}) * rig.right_from_left;
    while (seen.size() < kPoints) {
      const Eigen::Vector3d point(x(rng), y(rng), z(rng));
      StereoObservation o;
      o.left = rig.left.Project(point) + kNoise_px * Eigen::Vector2d(normal(rng), normal(rng));
      o.right = rig.right.Project(right_from_left * point) +
                kNoise_px * Eigen::Vector2d(normal(rng), normal(rng));
      o.cov_px2 = Eigen::Matrix4d::Identity() * kNoise_px * kNoise_px;
      if (!rig.left.Contains(o.left) || !rig.right.Contains(o.right)) continue;
      points.push_back(point);
      seen.push_back(o);
    }
  }

  // The turn is found to a twentieth.
  bool IsRight(const Rigid3& right_from_left) const {
    const Rigid3 motion = right_from_left * rig.right_from_left.Inverse();
    return (motion.RotationVector() - Eigen::Vector3d(8e-4, 0, 0)).norm() < 4e-5;
  }
};

void RefineThePose(benchmark::State& state) {
  const Scene scene;
  RelativePose pose;
  for (auto _ : state) pose = RefineRelativePose(scene.rig, scene.seen);
  if (!scene.IsRight(pose.right_from_left)) state.SkipWithError("a wrong pose");
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kPoints));
}
BENCHMARK(RefineThePose)->Unit(benchmark::kMillisecond)->UseRealTime();

// The baseline: bundle adjustment with every point free, from the same matches; no modes.
void AdjustPoseAndPoints(benchmark::State& state) {
  const Scene scene;
  BundleProblem problem;
  problem.cameras = {{scene.rig.left, true}, {scene.rig.right, true}};
  problem.motions = {{scene.rig.right_from_left}};
  for (std::size_t i = 0; i < scene.seen.size(); ++i) {
    const StereoObservation& o = scene.seen[i];
    const auto point = static_cast<int>(i);
    problem.points.push_back({scene.points[i]});
    problem.observations.push_back({0, -1, -1, point, o.left, o.cov_px2.topLeftCorner<2, 2>()});
    problem.observations.push_back({1, 0, -1, point, o.right, o.cov_px2.bottomRightCorner<2, 2>()});
  }
  BundleOptions options;
  options.gauge = BundleGauge::kMinimalPrior;
  Rigid3 found;
  for (auto _ : state) found = AdjustBundle(problem, options).solved.motions[0].motion;
  if (!scene.IsRight(found)) state.SkipWithError("a wrong pose");
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kPoints));
}
BENCHMARK(AdjustPoseAndPoints)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace plumbline
