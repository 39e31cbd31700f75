#include <benchmark/benchmark.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <random>
#include <vector>

#include "fit/ground_plane.h"

namespace plumbline {
namespace {

constexpr int kPoints = 1'000'000;

struct Cloud {
  Eigen::Vector3d normal = Eigen::Vector3d(0.2, -0.1, -1).normalized();
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Matrix3d> cov;

  Cloud() {
    std::mt19937 rng(3);
    std::uniform_real_distribution<double> place(-60, 60);
    std::normal_distribution<double> noise(0, 0.02);
    for (int i = 0; i < kPoints; ++i) {
      const double x = place(rng), y = place(rng);
      const double z = 380 - (normal.x() * x + normal.y() * y) / normal.z();
      points.emplace_back(x, y, z + noise(rng));
      cov.push_back(Eigen::Vector3d(1e-6, 1e-6, 4e-4).asDiagonal());
    }
  }
};

const Cloud& TheCloud() {
  static const Cloud cloud;
  return cloud;
}

bool IsRight(const Eigen::Vector3d& normal) {
  return normal.cross(TheCloud().normal).norm() < 1e-5;
}

void GroundPlaneWithCovariance(benchmark::State& state) {
  for (auto _ : state) {
    if (!IsRight(FitGroundPlane(TheCloud().points, TheCloud().cov).normal))
      state.SkipWithError("wrong plane");
  }
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(GroundPlaneWithCovariance)->Unit(benchmark::kMillisecond);

// The baseline: plain least squares by the moments' smallest eigenvector; no outliers, no weights,
// no covariance.
void PlainLeastSquares(benchmark::State& state) {
  for (auto _ : state) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const auto& p : TheCloud().points) mean += p / kPoints;
    Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
    for (const auto& p : TheCloud().points) moments += (p - mean) * (p - mean).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moments);
    if (!IsRight(eigen.eigenvectors().col(0))) state.SkipWithError("wrong plane");
  }
  state.SetItemsProcessed(state.iterations() * kPoints);
}
BENCHMARK(PlainLeastSquares)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace plumbline
