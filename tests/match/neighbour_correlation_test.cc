#include "match/neighbour_correlation.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/LU>
#include <limits>

#include "calib/error.h"
#include "tests/support/subset_noise.h"

namespace plumbline {
namespace {

using testing::SpeckleTexture;
using testing::SubsetAnswer;

TEST(NeighbourCorrelation, IsTheSharedAreaForOrdersZeroAndOne) {
  for (const int order : {0, 1}) {
    const auto correlation = NeighbourCorrelation::OfOverlap({30, 20}, 4, 21, order);
    EXPECT_EQ(correlation.reach(), 5);
    for (int dr = -7; dr <= 7; ++dr) {
      for (int dc = -7; dc <= 7; ++dc) {
        const double share =
            std::max(0, 21 - 4 * std::abs(dr)) * std::max(0, 21 - 4 * std::abs(dc)) / (21.0 * 21);
        const Eigen::Matrix2f R = correlation.Between(10, 10, dr, dc);
        EXPECT_NEAR(R(0, 0), share, 1e-5);
        EXPECT_NEAR(R(1, 1), share, 1e-5);
        EXPECT_EQ(R(0, 1), 0);
        EXPECT_EQ(R(1, 0), 0);
      }
    }
  }
}

// The weights of a polynomial's value at the centre, from the normal equations themselves.
std::vector<double> CentreWeights(int side, int order, bool circular) {
  const int radius = side / 2, terms = (order + 1) * (order + 2) / 2;
  Eigen::MatrixXd P = Eigen::MatrixXd::Zero(side * side, terms);
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      if (circular && std::hypot(x, y) > 0.5 * side) continue;
      Eigen::RowVectorXd row(6);
      row << 1, x, y, x * x, x * y, y * y;
      P.row((y + radius) * side + x + radius) = row.head(terms);
    }
  }
  const Eigen::VectorXd w = P * (P.transpose() * P).inverse().col(0);
  return {w.data(), w.data() + w.size()};
}

TEST(NeighbourCorrelation, FollowsTheKernelOfOrderTwoAndOfCircles) {
  constexpr int kSide = 15, kStep = 3;
  for (const bool circular : {false, true}) {
    const auto w = CentreWeights(kSide, 2, circular);
    const auto correlation = NeighbourCorrelation::OfOverlap({9, 9}, kStep, kSide, 2, circular);
    for (const Eigen::Vector2i& d :
         {Eigen::Vector2i(0, 0), Eigen::Vector2i(1, 0), Eigen::Vector2i(-2, 1),
          Eigen::Vector2i(3, -4), Eigen::Vector2i(-4, -4)}) {
      double shared = 0, own = 0;
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          const double here = w[static_cast<std::size_t>(y * kSide + x)];
          own += here * here;
          const int ox = x - kStep * d.x(), oy = y - kStep * d.y();
          if (ox >= 0 && oy >= 0 && ox < kSide && oy < kSide)
            shared += here * w[static_cast<std::size_t>(oy * kSide + ox)];
        }
      }
      EXPECT_NEAR(correlation.Between(4, 4, d.y(), d.x())(0, 0), shared / own, 1e-5)
          << d.transpose();
    }
  }
}

struct Case {
  int step_px, subset_px, order;
  bool circular, masked, noisy;
};

class OfTexture : public ::testing::TestWithParam<Case> {};

TEST_P(OfTexture, IsTheSumOverSharedPixelsWhereEveryPointIsANode) {
  const Case& c = GetParam();
  const SpeckleTexture speckle({70, 60}, 11);
  const SubsetGrid subsets{{9, 7}, {8, 9}, c.step_px, c.subset_px, c.order, c.circular};
  Image<std::uint8_t> mask({70, 60}, 1);
  Image<float> variance({70, 60});
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 70; ++x) {
      mask(y, x) = x - y > 12 && x - y < 18 ? 0 : 1;
      variance(y, x) = 1 + 0.1F * static_cast<float>(x);
    }
  }
  ReferenceTexture texture = speckle.Texture();
  if (c.masked) texture.mask = &mask;
  if (c.noisy) texture.variance_grey2 = &variance;
  const auto correlation = NeighbourCorrelation::OfTexture(subsets, texture);
  const SubsetAnswer here(subsets, texture, 3, 4);
  const SubsetAnswer corner(subsets, texture, 0, 0);
  for (int dr = -3; dr <= 3; ++dr) {
    for (int dc = -4; dc <= 4; ++dc) {
      const SubsetAnswer there(subsets, texture, 3 + dr, 4 + dc);
      const Eigen::Matrix2d expected = here.Correlation(there, texture.variance_grey2);
      const Eigen::Matrix2f R = correlation.Between(3, 4, dr, dc);
      EXPECT_LT((R.cast<double>() - expected).cwiseAbs().maxCoeff(), 2e-4)
          << dr << ' ' << dc << '\n'
          << R << '\n'
          << expected;
    }
  }
  const SubsetAnswer beside(subsets, texture, 1, 1);
  EXPECT_LT((correlation.Between(0, 0, 1, 1).cast<double>() -
             corner.Correlation(beside, texture.variance_grey2))
                .cwiseAbs()
                .maxCoeff(),
            2e-4);
}

INSTANTIATE_TEST_SUITE_P(Cases, OfTexture,
                         ::testing::Values(Case{6, 21, 1, false, false, false},
                                           Case{6, 21, 0, false, false, true},
                                           Case{5, 21, 2, false, true, false},
                                           Case{6, 21, 2, true, true, true},
                                           Case{7, 5, 1, false, false, false}));

TEST(NeighbourCorrelation, IsCloseBetweenTheNodesOfADenseGrid) {
  for (const int order : {1, 2}) {
    const SpeckleTexture speckle({90, 90}, 5);
    const SubsetGrid subsets{{45, 45}, {1, 1}, 2, 25, order, false};
    const auto correlation = NeighbourCorrelation::OfTexture(subsets, speckle.Texture());
    double sum2 = 0, overlap_sum2 = 0;
    int count = 0;
    const auto overlap = NeighbourCorrelation::OfOverlap(subsets.grid, 2, 25, order);
    for (int row = 10; row < 34; row += 5) {
      for (int column = 9; column < 34; column += 6) {
        const SubsetAnswer here(subsets, speckle.Texture(), row, column);
        const Eigen::Vector2i d(-4 + (row * 7 + column) % 9, -4 + (row + column * 5) % 9);
        const SubsetAnswer there(subsets, speckle.Texture(), row + d.y(), column + d.x());
        const Eigen::Matrix2d expected = here.Correlation(there, nullptr);
        const auto error = [&](const NeighbourCorrelation& of) {
          return (of.Between(row, column, d.y(), d.x()).cast<double>() - expected).squaredNorm();
        };
        sum2 += error(correlation);
        overlap_sum2 += error(overlap);
        count += 4;
      }
    }
    EXPECT_LT(std::sqrt(sum2 / count), 0.045) << order;
    EXPECT_LT(sum2, 0.5 * overlap_sum2) << order;
    RecordProperty("rms", std::to_string(std::sqrt(sum2 / count)));
    RecordProperty("overlap_rms", std::to_string(std::sqrt(overlap_sum2 / count)));
  }
}

TEST(NeighbourCorrelation, IsTransposedFromTheOtherPoint) {
  const SpeckleTexture speckle({90, 90}, 6);
  for (const int step : {2, 6}) {
    const SubsetGrid subsets{{90 / step, 90 / step}, {0, 0}, step, 21, 1, false};
    const auto correlation = NeighbourCorrelation::OfTexture(subsets, speckle.Texture());
    const int reach = correlation.reach();
    for (int dr = -reach - 1; dr <= reach + 1; ++dr) {
      for (int dc = -reach - 1; dc <= reach + 1; ++dc) {
        const Eigen::Matrix2f R = correlation.Between(7, 7, dr, dc);
        EXPECT_EQ(R, correlation.Between(7 + dr, 7 + dc, -dr, -dc).transpose());
        if (std::max(std::abs(dr), std::abs(dc)) > reach) {
          EXPECT_TRUE(R.isZero());
        }
      }
    }
    const Eigen::Matrix2f own = correlation.Between(7, 7, 0, 0);
    EXPECT_NEAR(own(0, 0), 1, 1e-5);
    EXPECT_NEAR(own(1, 1), 1, 1e-5);
    EXPECT_LT(std::abs(own(0, 1)), 0.5);
    EXPECT_NE(own(0, 1), 0);
  }
}

TEST(NeighbourCorrelation, FallsBackToTheOverlapWithoutTexture) {
  SpeckleTexture speckle({80, 40}, 8);
  Image<std::uint8_t> mask({80, 40}, 1);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 40; ++x) speckle.gx(y, x) = speckle.gy(y, x) = 0;
    for (int x = 60; x < 80; ++x) {
      mask(y, x) = 0;
      speckle.gx(y, x) = std::numeric_limits<float>::quiet_NaN();
      speckle.grey(y, x) = std::numeric_limits<float>::infinity();
    }
  }
  ReferenceTexture texture = speckle.Texture();
  texture.mask = &mask;
  const SubsetGrid subsets{{15, 7}, {4, 4}, 5, 15, 1, false};
  const auto correlation = NeighbourCorrelation::OfTexture(subsets, texture);
  const auto overlap = NeighbourCorrelation::OfOverlap(subsets.grid, 5, 15, 1);
  for (const int column : {2, 14}) {
    EXPECT_EQ(correlation.Between(3, column, 1, -1), overlap.Between(3, column, 1, -1));
  }
  for (int column = 0; column < 15; ++column) {
    for (int d = -2; d <= 2; ++d) {
      EXPECT_TRUE(correlation.Between(3, column, 1, d).allFinite()) << column;
    }
  }
  EXPECT_NE(correlation.Between(3, 9, 1, -1), overlap.Between(3, 9, 1, -1));
}

TEST(NeighbourCorrelation, IsTheSameForAnyNumberOfThreads) {
  const SpeckleTexture speckle({160, 120}, 9);
  const SubsetGrid subsets{{50, 40}, {2, 2}, 3, 21, 2, false};
  const auto table = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return NeighbourCorrelation::OfTexture(subsets, speckle.Texture());
  };
  const auto one = table(1), four = table(4);
  for (int row = 0; row < 40; row += 3) {
    for (int column = 0; column < 50; ++column) {
      EXPECT_EQ(one.Between(row, column, 2, -3), four.Between(row, column, 2, -3));
      EXPECT_EQ(one.Between(row, column, 0, 1), four.Between(row, column, 0, 1));
    }
  }
}

TEST(NeighbourCorrelation, TakesAFieldOfOnePoint) {
  const SpeckleTexture speckle({31, 31}, 3);
  const auto correlation =
      NeighbourCorrelation::OfTexture({{1, 1}, {15, 15}, 4, 21, 1, false}, speckle.Texture());
  EXPECT_NEAR(correlation.Between(0, 0, 0, 0)(0, 0), 1, 1e-5);
}

TEST(NeighbourCorrelation, RefusesWhatItCannotUse) {
  const SpeckleTexture speckle({31, 31}, 3);
  EXPECT_THROW(NeighbourCorrelation::OfOverlap({3, 3}, 0, 21, 1), UsageError);
  EXPECT_THROW(NeighbourCorrelation::OfOverlap({3, 3}, 1, 20, 1), UsageError);
  EXPECT_THROW(NeighbourCorrelation::OfOverlap({3, 3}, 1, 21, 3), UsageError);
  EXPECT_THROW(NeighbourCorrelation::OfOverlap({0, 3}, 1, 21, 1), UsageError);
  const SubsetGrid subsets{{3, 3}, {5, 5}, 4, 11, 1, false};
  EXPECT_THROW(NeighbourCorrelation::OfTexture(subsets, {}), InputError);
  ReferenceTexture texture = speckle.Texture();
  const Image<float> other({31, 30});
  texture.gradient_y = &other;
  EXPECT_THROW(NeighbourCorrelation::OfTexture(subsets, texture), InputError);
}

}  // namespace
}  // namespace plumbline
