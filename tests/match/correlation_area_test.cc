#include "match/correlation_area.h"

#include <gtest/gtest.h>

namespace plumbline {
namespace {

constexpr ImageSize kGrid{40, 30};

double AreaOf(int step_px, int subset_px, int order) {
  return CorrelationArea(NeighbourCorrelation::OfOverlap(kGrid, step_px, subset_px, order), kGrid);
}

// Over a field the weights of all subsets of order 0 and 1 share as much as the subsets do. Those
// of order 2 have 3.5 times the variance in one point (1 + 5/4 + 5/4 for a square) and the same one
// in a mean over many.
TEST(CorrelationArea, IsThatOfASubsetOrLessByWhatItsOrderCosts) {
  EXPECT_NEAR(AreaOf(3, 33, 1), 121, 2);
  EXPECT_NEAR(AreaOf(3, 33, 0), AreaOf(3, 33, 1), 1e-3);
  EXPECT_NEAR(AreaOf(3, 33, 1) / AreaOf(3, 33, 2), 3.5, 0.05);
}

TEST(CorrelationArea, IsOneWherePointsAreApart) {
  EXPECT_NEAR(AreaOf(40, 33, 1), 1, 1e-6);
  EXPECT_NEAR(AreaOf(40, 33, 2), 1, 1e-6);
}

}  // namespace
}  // namespace plumbline
