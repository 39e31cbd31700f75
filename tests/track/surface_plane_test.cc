#include "track/surface_plane.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <vector>

#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

// Subsets of 3 x 3 cells of noise, a point a cell: their means go together as subsets that overlap
// do.
TEST(PlaneCovariance, IsTheScatterOfAFieldWithEdgesWhoseErrorsGoTogether) {
  constexpr ImageSize kGrid{12, 9};
  constexpr double kSigma_mm = 0.02;
  const auto neighbours = NeighbourCorrelation::OfOverlap(kGrid, 5, 15, 1);
  GroundPlane truth;
  truth.normal = Eigen::Vector3d(0.1, -0.2, -1).normalized();
  truth.offset_mm = truth.normal.z() * 400;
  testing::NormalDeviates draw(3);
  constexpr int kDraws = 500;
  double nees = 0, with_one_factor = 0;
  for (int n = 0; n < kDraws; ++n) {
    Image<double> cells({kGrid.width + 2, kGrid.height + 2}, 0.0);
    for (double& cell : cells.values()) cell = draw();
    std::vector<Eigen::Vector3d> points;
    std::vector<Eigen::Matrix3d> cov;
    std::vector<std::size_t> places;
    for (int r = 0; r < kGrid.height; ++r) {
      for (int c = 0; c < kGrid.width; ++c) {
        double error = 0;
        for (int k = 0; k < 9; ++k) error += cells(r + k / 3, c + k % 3) / 3;
        const double x = c - 6, y = r - 4;
        const double z =
            (truth.offset_mm - truth.normal.x() * x - truth.normal.y() * y) / truth.normal.z();
        points.push_back(Eigen::Vector3d(x, y, z) + kSigma_mm * error * truth.normal);
        cov.push_back(kSigma_mm * kSigma_mm * Eigen::Matrix3d::Identity());
        places.push_back(places.size());
      }
    }
    const std::vector<std::uint8_t> all(points.size(), 1);
    const GroundPlane plane = RefitPlane(points, cov, all, 9);
    const Eigen::Vector3d off = PlaneDifference(plane, truth);
    nees +=
        off.dot(PlaneCovariance(plane, points, cov, places, kGrid, neighbours).ldlt().solve(off));
    with_one_factor += off.dot(plane.cov.ldlt().solve(off));
  }
  EXPECT_NEAR(nees / kDraws, 3, 0.3);
  EXPECT_LT(with_one_factor / kDraws, 2.4);
}

TEST(PlaneCovariance, IsThatOfTheFitWherePointsAreIndependent) {
  constexpr ImageSize kGrid{7, 6};
  const auto neighbours = NeighbourCorrelation::OfOverlap(kGrid, 15, 15, 1);
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Matrix3d> cov;
  std::vector<std::size_t> places;
  testing::NormalDeviates draw(4);
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      points.emplace_back(c, r, 300 + 1e-4 * draw());
      cov.push_back((1e-4 + 1e-5 * c) * Eigen::Matrix3d::Identity());
      places.push_back(places.size());
    }
  }
  const std::vector<std::uint8_t> all(points.size(), 1);
  const GroundPlane plane = RefitPlane(points, cov, all);
  const Eigen::Matrix3d found = PlaneCovariance(plane, points, cov, places, kGrid, neighbours);
  EXPECT_LT((found - plane.cov).norm(), 1e-6 * plane.cov.norm());
}

}  // namespace
}  // namespace plumbline
