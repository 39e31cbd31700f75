#include "match/internal/motion_memory.h"

#include <gtest/gtest.h>

#include <functional>

namespace plumbline::internal {
namespace {

constexpr ImageSize kGrid{6, 5};
using Motion = std::function<Eigen::Vector2d(const Eigen::Vector2d& pixel)>;

PlanarField Moved(const Motion& motion) {
  PlanarField field(kGrid, {20, 20}, 10);
  field.subset_px = 21;
  for (int r = 0; r < kGrid.height; ++r) {
    for (int c = 0; c < kGrid.width; ++c) {
      field.status(r, c) = Status::kOk;
      field.displacement_px(r, c) = motion(field.PixelOf(r, c));
      field.gradient(r, c).setZero();
    }
  }
  return field;
}

PlanarField MovedBy(double x, double y) {
  return Moved([=](const Eigen::Vector2d&) { return Eigen::Vector2d(x, y); });
}

TEST(MotionMemory, ExpectsNothingAtFirst) {
  MotionMemory memory;
  EXPECT_EQ(memory.Expected(), nullptr);
  PlanarField lost = MovedBy(1, 2);
  for (Status& status : lost.status.values()) status = Status::kLowCorrelation;
  memory.Take(lost);
  EXPECT_EQ(memory.Expected(), nullptr);
}

TEST(MotionMemory, ExpectsAPointWhereItWasUntilItsMotionIsSteady) {
  MotionMemory memory;
  memory.Take(MovedBy(2, 0));
  EXPECT_EQ(memory.Expected()->displacement_px(2, 3), Eigen::Vector2d(2, 0));
  memory.Take(MovedBy(5, 1));
  EXPECT_EQ(memory.Expected()->displacement_px(2, 3), Eigen::Vector2d(5, 1));
  memory.Take(MovedBy(8.5, 2));  // from (5, 1) by nearly the same once more
  EXPECT_EQ(memory.Expected()->displacement_px(2, 3), Eigen::Vector2d(12, 3));
  memory.Take(MovedBy(12, 3));
  EXPECT_EQ(memory.Expected()->displacement_px(2, 3), Eigen::Vector2d(15.5, 4));
}

TEST(MotionMemory, ExpectsAPointWhereItWasAfterATurn) {
  MotionMemory memory;
  for (const double x : {1.0, 2.0, 3.0, 1.5}) memory.Take(MovedBy(x, 0));
  EXPECT_EQ(memory.Expected()->displacement_px(0, 0), Eigen::Vector2d(1.5, 0));
}

TEST(MotionMemory, TakesTheGradientsOnToo) {
  MotionMemory memory;
  for (int k = 1; k <= 4; ++k) {
    PlanarField field = MovedBy(k, 0);
    const float turn = 0.01F * static_cast<float>(k);
    for (auto& gradient : field.gradient.values()) gradient << 0, turn, -turn, 0;
    memory.Take(field);
  }
  EXPECT_NEAR(memory.Expected()->gradient(1, 1)(0, 1), 0.05, 1e-6);
}

TEST(MotionMemory, ExpectsALostPointWhereItWasSeenForTenFrames) {
  MotionMemory memory;
  for (int k = 1; k <= 3; ++k) memory.Take(MovedBy(k, 0));
  for (int k = 4; k <= 14; ++k) {
    PlanarField field = MovedBy(k, 0);
    field.status(1, 1) = Status::kLowCorrelation;
    memory.Take(field);
    EXPECT_EQ(memory.Expected()->displacement_px(2, 2), Eigen::Vector2d(k + 1, 0));
    if (k <= 13) {
      EXPECT_EQ(memory.Expected()->status(1, 1), Status::kOk) << k;
      EXPECT_EQ(memory.Expected()->displacement_px(1, 1), Eigen::Vector2d(3, 0)) << k;
    } else {
      EXPECT_EQ(memory.Expected()->status(1, 1), Status::kLowCorrelation);
    }
  }
  // Seen again, it counts from there.
  memory.Take(MovedBy(15, 0));
  EXPECT_EQ(memory.Expected()->displacement_px(1, 1), Eigen::Vector2d(15, 0));
}

TEST(MotionMemory, GoesOnFromWhatAnotherReferenceLetsExpect) {
  MotionMemory memory;
  for (int k = 1; k <= 3; ++k) memory.Take(MovedBy(k, 0));
  memory.Replace(MovedBy(0.5, 0));
  EXPECT_EQ(memory.Expected()->displacement_px(0, 0), Eigen::Vector2d(0.5, 0));
  memory.Forget();
  EXPECT_EQ(memory.Expected(), nullptr);
}

}  // namespace
}  // namespace plumbline::internal
