#include "match/internal/field_parts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace plumbline::internal {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

// All points kOk with a sigma of 0.01 px along both axes, moving as told.
PlanarField FieldOf(ImageSize grid,
                    const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& motion) {
  PlanarField field(grid, {0, 0}, 10);
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column) {
      field.status(row, column) = Status::kOk;
      field.displacement_px(row, column) = motion(field.PixelOf(row, column));
      field.gradient(row, column).setZero();
      field.cov_displacement_px2(row, column) = {1e-4F, 0, 1e-4F};
    }
  }
  return field;
}

Eigen::Vector2d Halves(const Eigen::Vector2d& p) {
  return p.x() < 95 ? Eigen::Vector2d(0.003, 0) : Eigen::Vector2d(3, 1);
}

TEST(FieldParts, AreCutByJumpsAndByPointsThatAreNotOk) {
  PlanarField field = FieldOf({20, 8}, Halves);
  std::vector<FieldPart> parts = PartsOf(field);
  ASSERT_EQ(parts.size(), 2U);
  EXPECT_EQ(parts[0].points.size(), 80U);
  EXPECT_TRUE(parts[0].still);
  EXPECT_FALSE(parts[1].still);
  EXPECT_NEAR(parts[1].median_motion_px, std::sqrt(10), 1e-9);
  for (int row = 0; row < 8; ++row) field.status(row, 15) = Status::kLowTexture;
  parts = PartsOf(field);
  ASSERT_EQ(parts.size(), 3U);
  EXPECT_EQ(parts[2].points.size(), 32U);
}

// A strain of 0.2 moves neighbours 2 px apart: no jump, for the gradient lets expect it.
TEST(FieldParts, FollowTheGradient) {
  PlanarField field =
      FieldOf({20, 8}, [](const Eigen::Vector2d& p) { return Eigen::Vector2d(0.2 * p.x(), 0); });
  EXPECT_EQ(PartsOf(field).size(), 20U);
  for (Eigen::Matrix2f& gradient : field.gradient.values()) gradient(0, 0) = 0.2F;
  EXPECT_EQ(PartsOf(field).size(), 1U);
}

TEST(FieldParts, StillOnesAreBackgroundOnlyBesideMotion) {
  EXPECT_THAT(StillBackground(PartsOf(FieldOf({20, 8}, Halves))), ElementsAre(0U));
  const auto rest = [](const Eigen::Vector2d&) { return Eigen::Vector2d(0.001, 0); };
  EXPECT_THAT(StillBackground(PartsOf(FieldOf({20, 8}, rest))), IsEmpty());
  // A specimen clamped at one end: no jump, one part.
  const auto clamped = [](const Eigen::Vector2d& p) { return Eigen::Vector2d(0.01 * p.x(), 0); };
  EXPECT_THAT(StillBackground(PartsOf(FieldOf({20, 8}, clamped))), IsEmpty());
  // Too little moves.
  const auto corner = [](const Eigen::Vector2d& p) {
    return Eigen::Vector2d(p.x() < 35 && p.y() < 25 ? 4 : 0, 0);
  };
  EXPECT_THAT(StillBackground(PartsOf(FieldOf({20, 8}, corner))), IsEmpty());
}

TEST(FieldParts, AFewPointsBesideALargerPartAreIsolated) {
  const auto spike = [](const Eigen::Vector2d& p) {
    return Eigen::Vector2d(2 + (p == Eigen::Vector2d(50, 40) ? 3 : 0), 0);
  };
  PlanarField field = FieldOf({20, 8}, spike);
  std::vector<FieldPart> parts = PartsOf(field);
  ASSERT_EQ(parts.size(), 2U);
  EXPECT_THAT(IsolatedParts(parts, field), ElementsAre(1U));
  // Three points far from everything else contradict nobody.
  for (int row = 0; row < 8; ++row) {
    for (int column = 0; column < 20; ++column) {
      if (!(column < 10 || (column > 14 && column < 18 && row == 3))) {
        field.status(row, column) = Status::kMasked;
      }
    }
  }
  parts = PartsOf(field);
  ASSERT_EQ(parts.size(), 3U);
  EXPECT_THAT(IsolatedParts(parts, field), ElementsAre(2U));
}

}  // namespace
}  // namespace plumbline::internal
