#include "io/virtual_rig/board_surface.h"

#include <gtest/gtest.h>

#include <Eigen/QR>
#include <cmath>

#include "calib/error.h"
#include "tests/support/numeric_jacobian.h"

namespace plumbline {
namespace {

const BoardSpec kBoard = BoardSpec::Parse("donut-dots:14x10:7mm");
const Rigid3 kPose = Rigid3::FromRotationVector({0.3, -0.2, 0.1}, {-40, -30, 250});

BoardFlaws Flawed(std::uint64_t seed = 1) {
  BoardFlaws flaws;
  flaws.bend_mm = 0.4;
  flaws.misprint_mm = 0.03;
  flaws.scale_error = 0.002;
  flaws.seed = seed;
  return flaws;
}

// Off its nominal place, in the board frame.
Eigen::Matrix3Xd Departures(const BoardSurface& surface, const BoardSpec& spec) {
  Eigen::Matrix3Xd out(3, spec.PointCount());
  for (int id = 0; id < spec.PointCount(); ++id) {
    out.col(id) = surface.PointAsMade(id) - spec.NominalPoint(id);
  }
  return out;
}

TEST(BoardSurface, AnIdealBoardLiesAtItsNominalPointsInItsPose) {
  const BoardSurface surface(kBoard, {}, {}, kPose);
  const auto instant = surface.At(3.0);
  for (const int id : {0, 17, 139}) {
    const Eigen::Vector3d nominal = kBoard.NominalPoint(id);
    EXPECT_LT((surface.PointAsMade(id) - nominal).norm(), 1e-12);
    const SurfacePoint p = instant->At(nominal.head<2>());
    EXPECT_LT((p.position_mm - kPose * nominal).norm(), 1e-12);
    // Away from the cameras, by the convention of BoardSpec::NominalPoint().
    EXPECT_LT((p.Normal() - kPose.rotation.col(2)).norm(), 1e-12);
    EXPECT_EQ(instant->Velocity(nominal.head<2>()), Eigen::Vector3d(0, 0, 0));
  }
}

TEST(BoardSurface, TangentsAreTheDerivativesOfThePosition) {
  for (const char* word : {"donut-dots:14x10:7mm", "aprilgrid:3x2:20mm:0.3:tag36h11"}) {
    const BoardSurface surface(BoardSpec::Parse(word), {}, Flawed(), kPose);
    const auto instant = surface.At(0);
    // The last one beyond the sheet.
    for (const Eigen::Vector2d& q :
         {Eigen::Vector2d(3, 5), Eigen::Vector2d(70, 40), Eigen::Vector2d(-80, 200)}) {
      const Eigen::MatrixXd J = testing::NumericJacobian(
          [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
            return instant->At(x.head<2>()).position_mm;
          },
          q);
      EXPECT_LT((instant->At(q).d_position_d_material - J).norm(), 1e-9);
    }
  }
}

TEST(BoardSurface, BendIsAsDeepAsAskedAndLeavesThePlaneOfThePoints) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const BoardSurface surface(kBoard, {}, Flawed(seed), kPose);
    const Eigen::RowVectorXd z = Departures(surface, kBoard).row(2);
    EXPECT_NEAR(z.maxCoeff() - z.minCoeff(), 0.4, 1e-9);
    Eigen::MatrixXd J(kBoard.PointCount(), 3);
    for (int id = 0; id < kBoard.PointCount(); ++id) {
      J.row(id) << 1, kBoard.NominalPoint(id).head<2>().transpose();
    }
    EXPECT_LT((J.transpose() * z.transpose()).norm(), 1e-7);
  }
}

TEST(BoardSurface, MisprintHasTheRmsAskedAndNoScaleOfItsOwn) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    BoardFlaws flaws = Flawed(seed);
    flaws.scale_error = 0;
    const BoardSurface surface(kBoard, {}, flaws, kPose);
    const Eigen::Matrix2Xd shift = Departures(surface, kBoard).topRows<2>();
    EXPECT_NEAR(std::sqrt(shift.squaredNorm() / kBoard.PointCount()), 0.03, 1e-9);
    Eigen::Matrix2Xd arm(2, kBoard.PointCount());
    for (int id = 0; id < kBoard.PointCount(); ++id)
      arm.col(id) = kBoard.NominalPoint(id).head<2>();
    arm.colwise() -= arm.rowwise().mean().eval();
    EXPECT_LT(shift.rowwise().mean().norm(), 1e-9);
    EXPECT_NEAR((shift.array() * arm.array()).sum(), 0, 1e-6);
    EXPECT_NEAR(
        (shift.row(0).array() * arm.row(1).array() - shift.row(1).array() * arm.row(0).array())
            .sum(),
        0, 1e-6);
    // Smooth: neighbours are shifted alike, and yet not all the same.
    double step = 0;
    for (int id = 1; id < 14; ++id)
      step = std::max(step, (shift.col(id) - shift.col(id - 1)).norm());
    EXPECT_LT(step, 0.03);
    EXPECT_GT(step, 0.003);
  }
}

TEST(BoardSurface, ScaleErrorStretchesAllDistances) {
  BoardFlaws flaws;
  flaws.scale_error = 0.002;
  const BoardSurface surface(kBoard, {}, flaws, kPose);
  EXPECT_NEAR((surface.PointAsMade(139) - surface.PointAsMade(0)).norm(),
              1.002 * (kBoard.NominalPoint(139) - kBoard.NominalPoint(0)).norm(), 1e-9);
}

TEST(BoardSurface, FlawsFollowTheSeedAndGrowWithTheirSize) {
  const Eigen::Matrix3Xd one = Departures({kBoard, {}, Flawed(1), kPose}, kBoard);
  EXPECT_EQ(one, Departures({kBoard, {}, Flawed(1), Rigid3()}, kBoard));
  EXPECT_GT((one - Departures({kBoard, {}, Flawed(2), kPose}, kBoard)).norm(), 0.1);
  BoardFlaws bent = Flawed(1);
  bent.misprint_mm = bent.scale_error = 0;
  bent.bend_mm *= 2;
  const Eigen::Matrix3Xd other = Departures({kBoard, {}, bent, kPose}, kBoard);
  EXPECT_LT((other.row(2) - 2 * one.row(2)).norm(), 1e-12);
}

TEST(BoardSurface, MovesAsAWhole) {
  const BoardSurface surface(kBoard, {}, Flawed(), kPose);
  const BoardSurface moved = surface.MovedTo(Rigid3());
  EXPECT_EQ(moved.PointAsMade(5), surface.PointAsMade(5));
  const Eigen::Vector2d q(12, 34);
  EXPECT_LT((kPose * moved.At(0)->At(q).position_mm - surface.At(0)->At(q).position_mm).norm(),
            1e-12);
}

TEST(BoardSurface, DomainIsTheSheet) {
  BoardPrint print;
  print.margin_mm = 11;
  print.disc_share = 0.25;
  const BoardSurface surface(kBoard, print, {}, kPose);
  for (const MaterialDomain& d : {surface.Domain(), surface.Reference(1)->Window()}) {
    EXPECT_DOUBLE_EQ(d.u_min, -11 - 1.75);
    EXPECT_DOUBLE_EQ(d.u_max, 13 * 7 + 11 + 1.75);
    EXPECT_DOUBLE_EQ(d.v_min, -11 - 1.75);
    EXPECT_DOUBLE_EQ(d.v_max, 9 * 7 + 11 + 1.75);
    EXPECT_TRUE(std::isinf(d.period_u));
  }
}

TEST(BoardSurface, RefusesFlawsThatAreNone) {
  for (const auto& set : {+[](BoardFlaws& f) { f.bend_mm = -1; },
                          +[](BoardFlaws& f) { f.misprint_mm = std::nan(""); },
                          +[](BoardFlaws& f) { f.scale_error = 1; }}) {
    BoardFlaws flaws;
    set(flaws);
    EXPECT_THROW(BoardSurface(kBoard, {}, flaws, kPose), UsageError);
  }
  EXPECT_THROW(BoardSurface(kBoard, {}, {}, kPose).PointAsMade(140), std::out_of_range);
}

}  // namespace
}  // namespace plumbline
