#include "track/internal/gauge_fit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "tests/support/subset_noise.h"

namespace plumbline::internal {
namespace {

constexpr ImageSize kGrid{45, 38};
constexpr int kStepPx = 4, kSubsetPx = 21;

struct Field {
  testing::SpeckleTexture speckle{{220, 190}, 8};
  NeighbourCorrelation correlation = NeighbourCorrelation::OfTexture(
      {kGrid, {15, 15}, kStepPx, kSubsetPx, 1, false}, speckle.Texture());
  Image<Eigen::Vector3f> cov_px2{kGrid, Eigen::Vector3f::Zero()};
  Image<double> weight{kGrid};

  Field() {
    testing::NormalDeviates draw(3);
    for (std::size_t i = 0; i < weight.pixel_count(); ++i) {
      const double u = 1e-4 * (0.5 + draw.Uniform()), v = 1e-4 * (0.5 + draw.Uniform());
      cov_px2.data()[i] = Eigen::Vector3d(u, 0.3 * std::sqrt(u * v), v).cast<float>();
      weight.data()[i] = draw.Uniform() < 0.03 ? 0 : 0.5 + draw.Uniform();
    }
  }

  GaugeData Data(const Image<double>& weights, int order) const {
    return {correlation, cov_px2, weights, kStepPx, 4, order};
  }
};

TEST(FitsWithoutMissing, AreThoseOfAFitToThePointsThatAreLeft) {
  const Field field;
  // Single points, and a region.
  Image<double> present(kGrid, 1);
  testing::NormalDeviates draw(5);
  for (double& value : present.values()) value = draw.Uniform() < 0.04 ? 0 : 1;
  for (int r = 20; r < 27; ++r) {
    for (int c = 24; c < 33; ++c) present(r, c) = 0;
  }
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < 8; ++c) present(r, c) = 1;
  }
  Image<double> left = field.weight;
  for (std::size_t i = 0; i < left.pixel_count(); ++i) left.data()[i] *= present.data()[i];
  for (const int order : {1, 2, 3}) {
    const GaugeData all = field.Data(field.weight, order), rest = field.Data(left, order);
    int solved = 0, lost = 0, untouched = 0;
    for (const GridTile& tile : TilesOf(kGrid)) {
      const TileGauges gauges = FitGauges(all, tile, 40);
      const std::vector<GaugeFit> fits = FitsWithoutMissing(all, gauges, present, 40);
      const std::vector<GaugeFit> expected = FitGauges(rest, tile, 40).fits;
      for (std::size_t cell = 0; cell < fits.size(); ++cell) {
        const GaugeFit &fit = fits[cell], &its = expected[cell], &full = gauges.fits[cell];
        EXPECT_EQ(fit.points, its.points);
        EXPECT_EQ(fit.quarter_points, its.quarter_points);
        ASSERT_EQ(fit.solved, its.solved) << tile.RowOf(cell) << ' ' << tile.ColumnOf(cell);
        lost += full.solved && !fit.solved ? 1 : 0;
        untouched += full.solved && fit.points == full.points ? 1 : 0;
        if (!fit.solved) {
          EXPECT_TRUE(fit.cov_gradient.array().isNaN().all());
          continue;
        }
        ++solved;
        EXPECT_LT((fit.filter - its.filter).norm(), 1e-10 * its.filter.norm());
        EXPECT_LT((fit.cov_gradient - its.cov_gradient).norm(), 1e-10 * its.cov_gradient.norm());
      }
    }
    EXPECT_GT(solved, 1000);
    EXPECT_GT(lost, 50);
    EXPECT_GT(untouched, 50);
  }
}

}  // namespace
}  // namespace plumbline::internal
