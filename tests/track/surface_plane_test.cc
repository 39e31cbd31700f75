#include "track/surface_plane.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <vector>

#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

constexpr ImageSize kGrid{12, 9};
constexpr double kSigma_mm = 0.02;

GroundPlane Truth() {
  GroundPlane truth;
  truth.normal = Eigen::Vector3d(0.1, -0.2, -1).normalized();
  truth.offset_mm = truth.normal.z() * 400;
  return truth;
}

// Errors of unit sigma at the points of the grid. Subsets of 3 x 3 cells of noise, a point a cell:
// their means go together as subsets that overlap do.
Image<double> Errors(testing::NormalDeviates& draw) {
  Image<double> cells({kGrid.width + 2, kGrid.height + 2}, 0.0);
  for (double& cell : cells.values()) cell = draw();
  Image<double> errors(kGrid, 0.0);
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      for (int k = 0; k < 9; ++k) errors(r, c) += cells(r + k / 3, c + k % 3) / 3;
    }
  }
  return errors;
}

NeighbourCorrelation Neighbours() { return NeighbourCorrelation::OfOverlap(kGrid, 5, 15, 1); }

// Points of the true plane that are off by these errors along its normal.
struct NoisyPoints {
  Image<Eigen::Vector3d> point_mm{kGrid, Eigen::Vector3d::Zero()};
  std::vector<Eigen::Vector3d> taken;
  std::vector<Eigen::Matrix3d> cov;
  std::vector<std::size_t> places;

  // stride: of the points that a plane is fitted to.
  explicit NoisyPoints(const Image<double>& errors, int stride = 1) {
    const GroundPlane truth = Truth();
    for (int r = 0; r < kGrid.height; ++r) {
      for (int c = 0; c < kGrid.width; ++c) {
        const double x = c - 6, y = r - 4;
        const double z =
            (truth.offset_mm - truth.normal.x() * x - truth.normal.y() * y) / truth.normal.z();
        point_mm(r, c) = Eigen::Vector3d(x, y, z) + kSigma_mm * errors(r, c) * truth.normal;
        if (r % stride != 0 || c % stride != 0) continue;
        taken.push_back(point_mm(r, c));
        cov.push_back(kSigma_mm * kSigma_mm * Eigen::Matrix3d::Identity());
        places.push_back(static_cast<std::size_t>(r * kGrid.width + c));
      }
    }
  }
  PlanePoints All() const { return {taken, cov, places, kGrid}; }
  GroundPlane Fitted() const {
    return RefitPlane(taken, cov, std::vector<std::uint8_t>(taken.size(), 1), 9);
  }
};

TEST(PlaneCovariance, IsTheScatterOfAFieldWithEdgesWhoseErrorsGoTogether) {
  const NeighbourCorrelation neighbours = Neighbours();
  testing::NormalDeviates draw(3);
  constexpr int kDraws = 500;
  double nees = 0, with_one_factor = 0;
  for (int n = 0; n < kDraws; ++n) {
    const NoisyPoints points(Errors(draw));
    const GroundPlane plane = points.Fitted();
    const Eigen::Vector3d off = PlaneDifference(plane, Truth());
    nees += off.dot(PlaneCovariance(plane, points.All(), neighbours).ldlt().solve(off));
    with_one_factor += off.dot(plane.cov.ldlt().solve(off));
  }
  EXPECT_NEAR(nees / kDraws, 3, 0.3);
  EXPECT_LT(with_one_factor / kDraws, 2.4);
}

// Heights above a plane that was fitted to every second point: of these points, of those beside
// them, and of the same points seen again, whose noise is in part that of the first time.
TEST(HeightVarianceOfPlane, CountsThatPointsPullThePlaneAlong) {
  const NeighbourCorrelation neighbours = Neighbours();
  testing::NormalDeviates draw(5);
  constexpr int kDraws = 1500;
  constexpr double kAgain = 0.6;  // correlation of the second noise with the first
  struct Sum {
    double squares = 0, expected = 0, if_independent = 0;
  };
  Sum fitted, beside, again;
  for (int n = 0; n < kDraws; ++n) {
    const Image<double> first = Errors(draw);
    Image<double> second = Errors(draw);
    for (std::size_t i = 0; i < second.pixel_count(); ++i) {
      second.data()[i] =
          kAgain * first.data()[i] + std::sqrt(1 - kAgain * kAgain) * second.data()[i];
    }
    const NoisyPoints points(first, 2);
    GroundPlane plane = points.Fitted();
    plane.cov = PlaneCovariance(plane, points.All(), neighbours);
    const Image<Eigen::Vector3d> along = PlaneAlongPoints(plane, points.All(), neighbours);
    const auto add = [&](const Image<Eigen::Vector3d>& point_mm, int r, int c,
                         const Image<float>& added, Sum& sum) {
      const double height = plane.SignedDistance(point_mm(r, c));
      const Eigen::Vector3d q = point_mm(r, c) - plane.centroid;
      const Eigen::Vector3d J(-plane.e2.dot(q), plane.e1.dot(q), -1);
      sum.squares += height * height;
      sum.expected += kSigma_mm * kSigma_mm + static_cast<double>(added(r, c));
      sum.if_independent += kSigma_mm * kSigma_mm + J.dot(plane.cov * J);
    };
    const auto added_to = [&](const Image<Eigen::Vector3d>& point_mm, double correlation) {
      const Image<float> shared_mm(kGrid, static_cast<float>(correlation * kSigma_mm));
      return HeightVarianceOfPlane(plane, point_mm, along, shared_mm);
    };
    const NoisyPoints later(second, 2);
    const Image<float> at_rest = added_to(points.point_mm, 1),
                       of_later = added_to(later.point_mm, kAgain);
    for (int r = 0; r < kGrid.height; ++r) {
      for (int c = 0; c < kGrid.width; ++c) {
        const bool took_part = r % 2 == 0 && c % 2 == 0;
        add(points.point_mm, r, c, at_rest, took_part ? fitted : beside);
        add(later.point_mm, r, c, of_later, again);
      }
    }
  }
  for (const Sum* sum : {&fitted, &beside, &again}) {
    EXPECT_NEAR(sum->squares / sum->expected, 1, 0.02);
    EXPECT_LT(sum->squares / sum->if_independent, 0.9);
  }
}

TEST(HeightVarianceOfPlane, TakesOffThePlanesOwnWherePointsAreIndependent) {
  const auto neighbours = NeighbourCorrelation::OfOverlap(kGrid, 15, 15, 1);
  testing::NormalDeviates draw(6);
  Image<double> errors(kGrid, 0.0);
  for (double& error : errors.values()) error = draw();
  const NoisyPoints points(errors);
  GroundPlane plane = points.Fitted();
  plane.cov = PlaneCovariance(plane, points.All(), neighbours);
  const Image<float> added = HeightVarianceOfPlane(
      plane, points.point_mm, PlaneAlongPoints(plane, points.All(), neighbours),
      Image<float>(kGrid, static_cast<float>(kSigma_mm)));
  const Eigen::Vector3d q = points.point_mm(2, 3) - plane.centroid;
  const Eigen::Vector3d J(-plane.e2.dot(q), plane.e1.dot(q), -1);
  const double own = J.dot(plane.cov * J);
  EXPECT_NEAR(added(2, 3), -own, 1e-3 * own);
}

TEST(PlaneCovariance, IsThatOfTheFitWherePointsAreIndependent) {
  constexpr ImageSize kSmall{7, 6};
  const auto neighbours = NeighbourCorrelation::OfOverlap(kSmall, 15, 15, 1);
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Matrix3d> cov;
  std::vector<std::size_t> places;
  testing::NormalDeviates draw(4);
  for (int r = 0; r < kSmall.height; ++r) {
    for (int c = 0; c < kSmall.width; ++c) {
      points.emplace_back(c, r, 300 + 1e-4 * draw());
      cov.push_back((1e-4 + 1e-5 * c) * Eigen::Matrix3d::Identity());
      places.push_back(places.size());
    }
  }
  const std::vector<std::uint8_t> all(points.size(), 1);
  const GroundPlane plane = RefitPlane(points, cov, all);
  const Eigen::Matrix3d found = PlaneCovariance(plane, {points, cov, places, kSmall}, neighbours);
  EXPECT_LT((found - plane.cov).norm(), 1e-6 * plane.cov.norm());
}

}  // namespace
}  // namespace plumbline
